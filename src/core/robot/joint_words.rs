//! What a joint is called in texts.

/// Joint `i`, from 0, for people: by its name of the robot file, of which `names` are all; by its number, counted from 1, where it has none.
#[must_use]
pub fn joint_in_words<S: AsRef<str>>(names: &[S], i: usize) -> String {
    match names.get(i).map(AsRef::as_ref) {
        Some(name) if !name.is_empty() => format!("joint \"{name}\""),
        _ => format!("joint {}", i + 1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_joint_without_a_name_is_counted_from_one() {
        let names = ["base_yaw", ""];
        assert_eq!(
            [0, 1, 2].map(|i| joint_in_words(&names, i)),
            ["joint \"base_yaw\"", "joint 2", "joint 3"]
        );
    }
}
