//! Controls by name: which there are, what may be set, and what the device took.

use super::V4l2Error;
use super::fault::refused;
use super::node::{ControlKind, ControlOffer, VideoNode};
use crate::config::{ControlValue, V4l2Settings};
use crate::time::SpanNs;

/// The numbers of the controls that mean the exposure, as `<linux/v4l2-controls.h>` has them, because drivers and kernels name them in more than
/// one way.
const EXPOSURE_MODE: u32 = 0x009a_0901;
const EXPOSURE_TIME: u32 = 0x009a_0902;
/// The unit of the exposure time, by the kernel's specification of V4L2_CID_EXPOSURE_ABSOLUTE.
const EXPOSURE_UNIT: SpanNs = SpanNs(100_000);
/// Modes in which the exposure time is what it was set to: all by hand, and the aperture automatic.
const FIXED_EXPOSURE: [i64; 2] = [1, 2];

/// What newer and older kernels call the same control.
const OTHER_NAMES: [[&str; 2]; 4] = [
    ["auto_exposure", "exposure_auto"],
    ["exposure_time_absolute", "exposure_absolute"],
    ["white_balance_automatic", "white_balance_temperature_auto"],
    ["exposure_dynamic_framerate", "exposure_auto_priority"],
];

/// What a control may not do.
pub(super) struct Restrictions {
    pub(super) read_only: bool,
    pub(super) inactive: bool,
}

/// The kind of a control that can be used, from the kernel's numbers; `None` for headings and disabled ones.
pub(super) fn usable(kind: u32, flags: u32) -> Option<(ControlKind, Restrictions)> {
    // Bits of the kernel's V4L2_CTRL_FLAG_*, as that header has them.
    const DISABLED: u32 = 1;
    const READ_ONLY: u32 = 4;
    const INACTIVE: u32 = 0x10;
    let kind = match kind {
        1 => ControlKind::Integer,
        2 => ControlKind::Boolean,
        3 => ControlKind::Menu,
        4 => ControlKind::Button,
        5 => ControlKind::Integer64,
        6 => return None,
        8 => ControlKind::Bitmask,
        9 => ControlKind::IntegerMenu,
        _ => ControlKind::Compound,
    };
    let has = |flag: u32| flags & flag != 0;
    (!has(DISABLED)).then_some((kind, Restrictions { read_only: has(READ_ONLY), inactive: has(INACTIVE) }))
}

/// A driver's name as it is written in a run file: `Exposure Time, Absolute` is `exposure_time_absolute`.
pub(super) fn key_of(name: &str) -> String {
    let mut key = String::with_capacity(name.len());
    for c in name.chars() {
        if c.is_ascii_alphanumeric() {
            key.push(c.to_ascii_lowercase());
        } else if !key.is_empty() && !key.ends_with('_') {
            key.push('_');
        }
    }
    key.trim_end_matches('_').into()
}

/// The control of this name, by whichever of its names.
fn find<'a>(offers: &'a [ControlOffer], name: &str) -> Option<&'a ControlOffer> {
    let by = |name: &str| offers.iter().find(|offer| offer.name == name);
    by(name).or_else(|| {
        let [one, other] = OTHER_NAMES.into_iter().find(|pair| pair.contains(&name))?;
        by(if one == name { other } else { one })
    })
}

/// The number that `value` means for a control.
pub(super) fn number_of(offer: &ControlOffer, value: &ControlValue) -> Result<i64, V4l2Error> {
    let wrong = |allowed: String| V4l2Error::ControlValue {
        name: offer.name.clone(),
        value: value.to_string(),
        allowed,
    };
    if offer.read_only {
        return Err(wrong("it can only be read".into()));
    }
    let entries = || {
        let entries: Vec<_> = offer.menu.iter().map(|(n, name)| format!("{n} \"{name}\"")).collect();
        format!("allowed is one of {}", entries.join(", "))
    };
    let range = || format!("allowed is {} to {} in steps of {}", offer.minimum, offer.maximum, offer.step);
    match (offer.kind, value) {
        (ControlKind::Compound, _) => Err(wrong("it is text or an array, which cannot be set here".into())),
        (ControlKind::Boolean | ControlKind::Button, ControlValue::Switch(on)) => Ok(i64::from(*on)),
        (ControlKind::Boolean | ControlKind::Button, ControlValue::Number(n @ 0..=1)) => Ok(*n),
        (ControlKind::Boolean | ControlKind::Button, _) => Err(wrong("allowed is true or false".into())),
        (ControlKind::Menu | ControlKind::IntegerMenu, ControlValue::Entry(requested)) => offer
            .menu
            .iter()
            .find(|(_, name)| name.eq_ignore_ascii_case(requested))
            .map(|(n, _)| *n)
            .ok_or_else(|| wrong(entries())),
        (ControlKind::Menu | ControlKind::IntegerMenu, ControlValue::Number(n)) => {
            offer.menu.iter().any(|(entry, _)| entry == n).then_some(*n).ok_or_else(|| wrong(entries()))
        }
        (ControlKind::Menu | ControlKind::IntegerMenu, ControlValue::Switch(_)) => Err(wrong(entries())),
        // The bounds of bits are those of an unsigned number.
        (ControlKind::Bitmask, ControlValue::Number(n)) => {
            let mask = offer.maximum & 0xffff_ffff;
            (*n & !mask == 0).then_some(*n).ok_or_else(|| wrong(format!("allowed are the bits of {mask:#x}")))
        }
        (ControlKind::Integer | ControlKind::Integer64, ControlValue::Number(n)) => {
            (offer.minimum..=offer.maximum).contains(n).then_some(*n).ok_or_else(|| wrong(range()))
        }
        (ControlKind::Integer | ControlKind::Integer64 | ControlKind::Bitmask, _) => Err(wrong(range())),
    }
}

/// Modes come first: whether a value has an effect may depend on one.
fn is_mode(kind: ControlKind) -> bool {
    matches!(kind, ControlKind::Boolean | ControlKind::Menu | ControlKind::IntegerMenu)
}

/// Sets what the run file says, and the exposure where it is to be set. Returns notes for people.
pub(super) fn apply(
    node: &mut dyn VideoNode,
    settings: &V4l2Settings,
    exposure: SpanNs,
) -> Result<Vec<String>, V4l2Error> {
    let mut told = Vec::new();
    let wanted = |offers: &[ControlOffer]| {
        let one = |(name, value): (&String, &ControlValue)| {
            let offer = find(offers, name).ok_or_else(|| V4l2Error::NoControl {
                name: name.clone(),
                offered: offers.iter().map(|o| o.name.as_str()).collect::<Vec<_>>().join(", "),
            })?;
            Ok((offer.clone(), number_of(offer, value)?))
        };
        settings.controls.iter().map(one).collect::<Result<Vec<_>, V4l2Error>>()
    };
    let mut offers = node.controls();
    // All are looked at before the first is set.
    for (offer, value) in wanted(&offers)?.iter().filter(|(offer, _)| is_mode(offer.kind)) {
        set(node, offer, *value, &mut told)?;
    }
    if settings.set_exposure {
        set_exposure(node, &offers, exposure, &mut told)?;
    }
    if !settings.controls.is_empty() {
        offers = node.controls(); // modes may have changed what has an effect, and bounds
    }
    for (offer, value) in wanted(&offers)?.iter().filter(|(offer, _)| !is_mode(offer.kind)) {
        set(node, offer, *value, &mut told)?;
    }
    Ok(told)
}

/// Sets one control and reads it back.
fn set(
    node: &mut dyn VideoNode,
    offer: &ControlOffer,
    value: i64,
    told: &mut Vec<String>,
) -> Result<(), V4l2Error> {
    let name = &offer.name;
    node.set_control(offer.id, offer.kind, value)
        .map_err(|e| refused(format!("control {name} = {value}"), e))?;
    if offer.kind == ControlKind::Button {
        return Ok(());
    }
    match node.control(offer.id, offer.kind) {
        Ok(taken) if taken != value => {
            told.push(format!("control {name}: asked for {value}, the device took {taken}"));
        }
        Ok(_) if offer.inactive => {
            told.push(format!("control {name} has no effect: an automatic mode of the device is on"));
        }
        Ok(_) | Err(_) => {} // what can only be written cannot be read back
    }
    Ok(())
}

fn set_exposure(
    node: &mut dyn VideoNode,
    offers: &[ControlOffer],
    exposure: SpanNs,
    told: &mut Vec<String>,
) -> Result<(), V4l2Error> {
    let by_id = |id: u32| offers.iter().find(|offer| offer.id == id);
    let Some(time) = by_id(EXPOSURE_TIME) else { return Err(V4l2Error::NoExposureControl) };
    let units = (exposure.0 + EXPOSURE_UNIT.0 / 2) / EXPOSURE_UNIT.0;
    let ms = |units: i64| units as f64 * EXPOSURE_UNIT.as_s() * 1e3;
    if !(time.minimum..=time.maximum).contains(&units) {
        let (min_ms, max_ms) = (ms(time.minimum), ms(time.maximum));
        return Err(V4l2Error::Exposure { asked_ms: exposure.as_s() * 1e3, min_ms, max_ms });
    }
    if let Some(mode) = by_id(EXPOSURE_MODE) {
        let fixed = FIXED_EXPOSURE.into_iter().find(|n| mode.menu.iter().any(|(entry, _)| entry == n));
        let Some(fixed) = fixed else { return Err(V4l2Error::NoExposureControl) };
        set(node, mode, fixed, told)?;
    }
    let now_active = ControlOffer { inactive: false, ..time.clone() };
    set(node, &now_active, units, told)
}

/// How the exposure of a device is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ExposureControls {
    has_time: bool,
    has_mode: bool,
}

impl ExposureControls {
    /// Of a node with these controls.
    pub(super) fn of(offers: &[ControlOffer]) -> Self {
        let has = |id: u32| offers.iter().any(|offer| offer.id == id);
        Self { has_time: has(EXPOSURE_TIME), has_mode: has(EXPOSURE_MODE) }
    }

    /// Length of the exposure as the device says; `None` where it does not.
    pub(super) fn read(self, node: &dyn VideoNode) -> Option<SpanNs> {
        if !self.has_time {
            return None;
        }
        let units = node.control(EXPOSURE_TIME, ControlKind::Integer).ok().filter(|n| *n > 0)?;
        Some(SpanNs(units.saturating_mul(EXPOSURE_UNIT.0)))
    }

    /// Whether the device changes it by itself.
    pub(super) fn is_automatic(self, node: &dyn VideoNode) -> bool {
        self.has_mode
            && node
                .control(EXPOSURE_MODE, ControlKind::Menu)
                .is_ok_and(|mode| !FIXED_EXPOSURE.contains(&mode))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn offer(kind: ControlKind, minimum: i64, maximum: i64) -> ControlOffer {
        ControlOffer {
            id: 1,
            name: "gain".into(),
            kind,
            minimum,
            maximum,
            step: 1,
            default: minimum,
            menu: vec![(1, "Manual Mode".into()), (3, "Aperture Priority Mode".into())],
            read_only: false,
            inactive: false,
        }
    }

    #[test]
    fn names_are_those_of_the_command_line_tools() {
        for (driver, key) in [
            ("Exposure Time, Absolute", "exposure_time_absolute"),
            ("Auto Exposure", "auto_exposure"),
            ("White Balance, Automatic", "white_balance_automatic"),
            ("Exposure (Absolute)", "exposure_absolute"),
            ("  LED1 Mode  ", "led1_mode"),
            ("S_EXT_CTRLS / Boolean", "s_ext_ctrls_boolean"),
            ("\u{1b}[31m", "31m"),
        ] {
            assert_eq!(key_of(driver), key);
        }
    }

    #[test]
    fn values_are_held_against_what_the_device_offers() {
        use ControlValue::{Entry, Number, Switch};
        let number = |kind, value: &ControlValue| number_of(&offer(kind, -5, 10), value);
        assert_eq!(number(ControlKind::Integer, &Number(-5)).unwrap(), -5);
        assert_eq!(number(ControlKind::Boolean, &Switch(true)).unwrap(), 1);
        assert_eq!(number(ControlKind::Boolean, &Number(0)).unwrap(), 0);
        assert_eq!(number(ControlKind::Menu, &Number(3)).unwrap(), 3);
        assert_eq!(number(ControlKind::Menu, &Entry("manual mode".into())).unwrap(), 1);
        for (kind, value, words) in [
            (ControlKind::Integer, Number(11), "allowed is -5 to 10"),
            (ControlKind::Integer, Switch(true), "allowed is -5 to 10"),
            (ControlKind::Boolean, Number(2), "true or false"),
            (ControlKind::Menu, Number(0), "1 \"Manual Mode\", 3 \"Aperture Priority Mode\""),
            (ControlKind::Menu, Entry("auto".into()), "one of 1 \"Manual"),
            (ControlKind::Bitmask, Number(0x10), "the bits of 0xa"),
            (ControlKind::Compound, Number(1), "cannot be set"),
        ] {
            let error = number(kind, &value).unwrap_err().to_string();
            assert!(error.contains(words) && error.contains("controls.gain"), "{error}");
        }
        let read_only = ControlOffer { read_only: true, ..offer(ControlKind::Integer, 0, 9) };
        assert!(number_of(&read_only, &Number(1)).unwrap_err().to_string().contains("only be read"));
    }

    #[test]
    fn a_control_answers_to_its_name_of_another_kernel() {
        let mut time = offer(ControlKind::Integer, 1, 5000);
        time.name = "exposure_absolute".into();
        let offers = [time];
        assert!(find(&offers, "exposure_time_absolute").is_some());
        assert!(find(&offers, "exposure_absolute").is_some());
        assert!(find(&offers, "auto_exposure").is_none());
    }

    #[test]
    fn headings_and_disabled_controls_are_left_out() {
        assert!(usable(6, 0).is_none() && usable(1, 1).is_none());
        let (kind, restrictions) = usable(3, 0x14).unwrap();
        assert!(kind == ControlKind::Menu && restrictions.read_only && restrictions.inactive);
        assert_eq!(usable(0x0106, 0).unwrap().0, ControlKind::Compound);
    }
}
