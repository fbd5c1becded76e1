//! `--report`: a page of figures and its data, of real processes. What the page looks like is judged in a browser, where there is one.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)] // a skipped test says so

use crate::common::{Instance, read_summary, vservo};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

/// What every report has beside its images.
const FILES: [&str; 10] = [
    "config.toml",
    "events.csv",
    "frames.csv",
    "goal.csv",
    "index.html",
    "measurements.csv",
    "poses.csv",
    "summary.json",
    "tick-times.csv",
    "trace.csv",
];

struct Reported {
    folder: TempDir,
    output: Output,
    summary: Value,
}

impl Reported {
    fn path(&self) -> PathBuf {
        self.folder.path().join("report")
    }

    fn text(&self, name: &str) -> String {
        std::fs::read_to_string(self.path().join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    fn page(&self) -> String {
        self.text("index.html")
    }
}

/// A run with a report, under a name of its own.
fn run(arguments: &[&str]) -> Reported {
    let folder = tempfile::tempdir().unwrap();
    let instance = Instance::new("report");
    let output = vservo()
        .args(arguments)
        .args(["--instance", &instance.name, "--report"])
        .arg(folder.path().join("report"))
        .output()
        .unwrap();
    instance.assert_gone();
    let err = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!err.contains("panicked"), "{err}");
    let summary = read_summary(&folder.path().join("report/summary.json"));
    Reported { folder, output, summary }
}

const LOCKSTEP: [&str; 3] = ["run", "--clock", "lockstep"];

/// Elements are closed in the order in which they were opened: what makes a drawing well-formed, and text in between is no markup.
fn assert_well_formed(xml: &str) {
    let mut open: Vec<&str> = Vec::new();
    let mut rest = xml;
    while let Some(at) = rest.find('<') {
        assert!(!rest[..at].contains('>'), "a stray > in {:?}", &rest[..at]);
        let end = rest[at..].find('>').expect("a tag ends") + at;
        let tag = &rest[at + 1..end];
        let name = tag.trim_start_matches('/').split([' ', '/']).next().unwrap();
        assert_eq!(tag.matches('"').count() % 2, 0, "{tag}");
        if tag.starts_with('/') {
            assert_eq!(open.pop(), Some(name), "in {tag}");
        } else if !tag.ends_with('/') {
            open.push(name);
        }
        for entity in rest[..at].split('&').skip(1) {
            let known = ["amp;", "lt;", "gt;", "quot;"];
            assert!(known.iter().any(|k| entity.starts_with(k)), "&{entity}");
        }
        rest = &rest[end + 1..];
    }
    assert_eq!(open, Vec::<&str>::new());
}

fn drawings(page: &str) -> Vec<&str> {
    let starts = page.match_indices("<svg").map(|(at, _)| at);
    starts.map(|at| &page[at..at + page[at..].find("</svg>").unwrap() + 6]).collect()
}

#[test]
fn a_report_does_not_change_a_lockstep_run() {
    let reported = run(&LOCKSTEP);
    let err = String::from_utf8_lossy(&reported.output.stderr);
    assert_eq!(reported.output.status.code(), Some(0), "{err}");
    let mut names: Vec<String> = std::fs::read_dir(reported.path())
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    let (images, others): (Vec<_>, Vec<_>) = names.into_iter().partition(|n| n.ends_with(".png"));
    assert_eq!(others, FILES);
    let (strip, images): (Vec<_>, Vec<_>) = images.into_iter().partition(|n| n.starts_with("frame-strip-"));
    assert_eq!(images.len(), 2, "the first frame and the last: {images:?}");
    assert!((8..=16).contains(&strip.len()), "{strip:?}");

    // The same run without a report.
    let plain = crate::common::run("unreported", &LOCKSTEP[1..]);
    assert_eq!(reported.summary["state_hash"], plain.summary["state_hash"]);
    assert!(reported.summary["state_hash"].is_string());

    // A row for every tick and every measurement.
    let rows = |name: &str| reported.text(name).lines().count() as u64 - 1;
    assert_eq!(rows("trace.csv"), reported.summary["ticks"].as_u64().unwrap());
    assert!(rows("measurements.csv") >= reported.summary["measurements"].as_u64().unwrap());
    let text = reported.text("trace.csv");
    let (head, last) = (text.lines().next().unwrap(), text.lines().last().unwrap());
    let column = |name: &str| {
        let at = head.split(',').position(|c| c == name).unwrap_or_else(|| panic!("{name} in {head}"));
        last.split(',').nth(at).unwrap().to_owned()
    };
    assert_eq!(column("tick"), (reported.summary["ticks"].as_u64().unwrap() - 1).to_string());
    assert!(column("q_4").parse::<f64>().unwrap().is_finite() && column("C_qw").parse::<f64>().is_ok());
    assert_eq!(text.lines().filter(|l| l.split(',').count() != head.split(',').count()).count(), 0);

    // The page: its parts, nothing from elsewhere, and every drawing well-formed.
    let page = reported.page();
    for part in [
        "Converged after",
        "vservo run --clock lockstep --seed 1",
        "Image plane",
        "Errors over time",
        "The way of the camera in space",
        "Joints within their limits",
        "Joint positions",
        "Joint velocities",
        "Joint torques and forces",
        "What happened when",
        "Latencies of the measurements",
        "Time was simulated",
        "The target was found in each of",
        env!("CARGO_PKG_VERSION"),
    ] {
        assert!(page.contains(part), "{part}");
    }
    let local = page.replace("http://www.w3.org/2000/svg", "");
    // One script of its own, for cursor and zoom, which asks nobody for anything.
    let (before, script) = local.split_once("<script>").unwrap();
    let (script, after) = script.split_once("</script>").unwrap();
    for word in ["http", "fetch", "import", "src", "XML", "eval", "Worker", "cookie", "Storage"] {
        assert!(!script.contains(word), "{word}");
    }
    let local = [before, after].concat();
    for word in ["http", "//", "<script", "@import", "url("] {
        let images = local.split("base64,").map(|p| p.split_once('"').map_or(p, |(_, after)| after));
        assert!(images.clone().all(|p| !p.contains(word)), "{word}");
    }
    assert!(!page.contains("NaN") && !page.contains("inf "), "no number is none");
    let drawings = drawings(&page);
    assert!(drawings.len() > 20, "{}", drawings.len());
    drawings.iter().for_each(|svg| assert_well_formed(svg));
}

/// The target is hidden for a while; the report of an earlier run and what else lies in the folder.
#[test]
fn a_lost_target_is_shown_and_only_an_old_report_is_replaced() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["frame-lost-000999.png", "notes.txt", "frame-mine.png"] {
        std::fs::write(folder.path().join(name), "old").unwrap();
    }
    let old = "<html><head><meta name=\"generator\" content=\"vservo\"></head>an earlier report</html>";
    std::fs::write(folder.path().join("index.html"), old).unwrap();
    let instance = Instance::new("reportlost");
    let sheet = ["from_s=0.3", "until_s=0.6", "size_m=[0.3, 0.3]"].map(|s| format!("scene.occluder.{s}"));
    let output = vservo()
        .args(LOCKSTEP)
        .args(sheet.iter().flat_map(|s| ["--set", s]))
        .args(["--instance", &instance.name, "--report"])
        .arg(folder.path())
        .output()
        .unwrap();
    instance.assert_gone();
    assert_eq!(output.status.code(), Some(0));
    let page = std::fs::read_to_string(folder.path().join("index.html")).unwrap();
    assert!(
        page.contains("The target was lost 1 times") && page.contains("Lost frame, number"),
        "{}",
        &page[..3000]
    );
    assert!(page.contains("--set 'scene.occluder.size_m=[0.3, 0.3]'"), "quoted for a shell");
    let exists = |name: &str| folder.path().join(name).exists();
    assert!(exists("notes.txt") && exists("frame-mine.png") && !exists("frame-lost-000999.png"));
    let events = std::fs::read_to_string(folder.path().join("events.csv")).unwrap();
    assert!(events.lines().count() >= 2, "holding and resumed: {events}");
}

#[test]
fn a_realtime_run_has_a_report_with_jitter() {
    let reported = run(&["run"]);
    assert_eq!(reported.summary["outcome"], "converged");
    let ticks = reported.summary["ticks"].as_u64().unwrap();
    let lost = reported.summary["lost_traces"].as_u64().unwrap();
    assert_eq!(reported.text("trace.csv").lines().count() as u64 - 1, ticks - lost);
    let counted: u64 = reported
        .text("tick-times.csv")
        .lines()
        .skip(1)
        .map(|l| l.rsplit(',').next().unwrap().parse::<u64>().unwrap())
        .sum();
    assert_eq!(counted, ticks + reported.summary["skipped_ticks"].as_u64().unwrap());
    assert!(reported.page().contains("ticks had their command within"));
}

#[test]
fn replayed_images_and_a_calibration_have_one_too() {
    let images = run(&LOCKSTEP);
    let replay = format!("camera.replay.folder={}", images.path().display());
    let reported = run(&[&LOCKSTEP[..], &["--set", "camera.source=replay", "--set", &replay]].concat());
    assert_eq!(
        reported.summary["outcome"],
        "finished",
        "{}",
        String::from_utf8_lossy(&reported.output.stderr)
    );
    let page = reported.page();
    assert!(
        page.contains("The way of the camera in space") && !page.contains("Joint positions"),
        "no arm moves"
    );

    let reported = run(&["calibrate", "latency", "--clock", "lockstep"]);
    assert_eq!(
        reported.summary["outcome"],
        "finished",
        "{}",
        String::from_utf8_lossy(&reported.output.stderr)
    );
    let page = reported.page();
    assert!(
        page.contains("vservo calibrate latency --clock lockstep --seed 1")
            && page.contains("camera stamps are")
    );
}

#[test]
fn a_folder_that_cannot_be_is_refused_before_the_start() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    std::fs::write(&file, "kept").unwrap();
    for path in [file.clone(), file.join("below"), PathBuf::from("/proc/nothing")] {
        let instance = Instance::new("reportrefused");
        let output = vservo()
            .args(LOCKSTEP)
            .args(["--instance", &instance.name, "--report"])
            .arg(&path)
            .output()
            .unwrap();
        let err = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(3), "{err}");
        assert!(err.contains("cannot be written") && output.stdout.is_empty(), "nothing has started: {err}");
    }
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "kept");
}

/// Neither the run file nor anything else that lies in the folder is touched; nor does the run begin.
#[test]
fn a_folder_of_something_else_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let theirs = [
        ("cell.toml", "[run]\nclock = \"lockstep\"\n"),
        ("trace.csv", "theirs"),
        ("frame-first-000000.png", "x"),
    ];
    for (name, text) in theirs {
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    let instance = Instance::new("reporttheirs");
    let arguments = ["run", "cell.toml", "--instance", &instance.name, "--report", "."];
    let output = vservo().args(arguments).current_dir(folder.path()).output().unwrap();
    let err = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{err}");
    assert!(err.contains("holds files and no report of vservo") && output.stdout.is_empty(), "{err}");
    for (name, text) in theirs {
        assert_eq!(std::fs::read_to_string(folder.path().join(name)).unwrap(), text);
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), theirs.len());
}

/// A disk that is full when the report is to be written: told, and the run is what it would be.
#[test]
fn a_full_disk_is_told_and_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let instance = Instance::new("reportfull");
    let lines = format!(
        "mount -t tmpfs -o size=200k tmpfs {0} || exit 77\n$VSERVO run --clock lockstep --instance {1} --report {0}/r; echo code $?",
        folder.path().display(),
        instance.name
    );
    let output = Command::new("unshare")
        .args(["-m", "sh", "-c", &lines])
        .env("VSERVO", env!("CARGO_BIN_EXE_vservo"))
        .output();
    let Some(output) = output.ok().filter(|o| o.status.code() != Some(77) && !o.stdout.is_empty()) else {
        return println!("skipped: needs root, and unshare and mount");
    };
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(out.contains("outcome       converged") && out.contains("code 3\n"), "{out}{err}");
    assert!(err.contains("trace.csv") && err.contains("cannot be written"), "{err}");
    assert!(!err.contains("panicked") && !err.contains("entity not found"), "{err}");
}

/// What control was to leave is not there while there is room again: the sentence says what there was too little of, and where to look.
#[test]
fn what_control_had_no_room_for_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let instance = Instance::new("reportroom");
    let lines = format!(
        "mount -t tmpfs -o size=4m tmpfs {0} || exit 77
         $VSERVO run --clock lockstep --duration-s 12 --set goal.hold_s=11 --instance {1} --report {0}/r",
        folder.path().display(),
        instance.name
    );
    let output = Command::new("unshare")
        .args(["-m", "sh", "-c", &lines])
        .env("VSERVO", env!("CARGO_BIN_EXE_vservo"))
        .output();
    let Some(output) = output.ok().filter(|o| o.status.code() != Some(77) && !o.stdout.is_empty()) else {
        return println!("skipped: needs root, and unshare and mount");
    };
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(out.contains("outcome       "), "the run is what it would be: {out}{err}");
    let told = err.lines().rfind(|line| line.starts_with("vservo: ")).unwrap_or_default();
    assert!(told.contains("trace.csv: cannot be written") && told.contains("the disk was full"), "{err}");
    assert!(told.contains("KiB are left now: df ") && told.contains("free some space"), "{err}");
}

/// What a browser says of a page in one scheme of colours; `None` without a browser.
fn looked_at(page: &Path, dark: bool) -> Option<(Vec<Value>, String)> {
    let browser = ["chromium", "chromium-browser", "google-chrome"]
        .into_iter()
        .find(|name| Command::new(name).arg("--version").output().is_ok_and(|o| o.status.success()))?;
    let profile = tempfile::tempdir().unwrap();
    let check = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/report/check.html");
    let output = Command::new(browser)
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--allow-file-access-from-files"])
        .args(["--virtual-time-budget=60000", "--enable-logging=stderr", "--dump-dom"])
        .arg(format!("--blink-settings=preferredColorScheme={}", u8::from(!dark)))
        .arg(format!("--user-data-dir={}", profile.path().display()))
        .arg(format!("file://{}#file://{}", check.display(), page.display()))
        .output()
        .unwrap();
    let dom = String::from_utf8_lossy(&output.stdout);
    let result = dom.split_once("<pre id=\"result\">").and_then(|(_, rest)| rest.split_once("</pre>"));
    let (result, _) = result.unwrap_or_else(|| panic!("no answer of the page: {dom}"));
    let json = result.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&");
    let console = String::from_utf8_lossy(&output.stderr).lines().filter(|l| l.contains("CONSOLE")).collect();
    Some((serde_json::from_str(&json).unwrap(), console))
}

/// At three widths, light and dark: nothing is said on the console, no letter is small, cut off or under another one.
#[test]
fn the_page_can_be_read_in_a_browser() {
    let sheet = ["--set", "scene.occluder.from_s=0.3", "--set", "scene.occluder.until_s=0.6"];
    let large = ["--set", "scene.occluder.size_m=[0.3, 0.3]"];
    let panda = concat!(env!("CARGO_MANIFEST_DIR"), "/config/panda.toml");
    for arguments in [[&LOCKSTEP[..], &sheet, &large].concat(), [&LOCKSTEP[..], &[panda]].concat()] {
        let reported = run(&arguments);
        let page = reported.path().join("index.html");
        if !is_readable(&page, (150, 8)) {
            return println!("skipped: needs chromium");
        }
        let (results, _) = looked_at(&page, false).unwrap();
        assert!(results.iter().all(|result| result["cursors"].as_u64() > Some(8)), "{results:?}");
    }
}

/// Asserts that a page can be read at three widths, light and dark, and has so many texts and drawings; false without a browser.
fn is_readable(page: &Path, (texts, drawings): (u64, u64)) -> bool {
    for dark in [false, true] {
        let Some((results, console)) = looked_at(page, dark) else { return false };
        assert_eq!(console, "");
        assert_eq!(results.len(), 3);
        for result in results {
            let wrong = result["wrong"].as_array().unwrap();
            assert_eq!(wrong, &Vec::<Value>::new(), "dark: {dark}, {}", page.display());
            let count = |what: &str| result[what].as_u64().unwrap();
            assert!(count("texts") > texts && count("drawings") >= drawings, "{result}");
            assert!(result["least"].as_f64().unwrap() >= 11.0, "{result}");
            assert_eq!(result["ground"].as_f64().unwrap() < 128.0, dark, "{result}");
        }
    }
    true
}

/// The pages of calibrations, likewise.
#[test]
fn pages_of_calibrations_can_be_read_in_a_browser() {
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("hand-eye.html");
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let ended = |arguments: &[&str]| {
        let output =
            vservo().args(arguments).args(["--report"]).arg(&page).current_dir(here).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    };
    ended(&["calibrate", "hand-eye", "--drive", "config/chessboard.toml"]);
    let text = std::fs::read_to_string(&page).unwrap();
    for part in [
        "Corners, view by view",
        "<pre>[camera.mount]\nkind = &quot;eye_in_hand&quot;",
        "off the simulated truth by",
        "The camera moved over",
    ] {
        assert!(text.contains(part), "{part}");
    }
    if !is_readable(&page, (60, 3)) {
        return println!("skipped: needs chromium");
    }
    let photographs = here.join("../shared/data/opencv-stereo-chessboard");
    let Ok(listed) = std::fs::read_dir(photographs) else { return println!("skipped: no ../shared") };
    let mut files: Vec<String> = listed
        .filter_map(|entry| Some(entry.ok()?.path().display().to_string()))
        .filter(|name| name.contains("left") && name.ends_with("g"))
        .collect();
    files.sort();
    let out = folder.path().join("camera.yaml").display().to_string();
    let files = files.iter().map(String::as_str);
    let board = ["--target", "chessboard:9x6:0.025", "--out", out.as_str()];
    ended(&["calibrate", "camera"].into_iter().chain(files).chain(board).collect::<Vec<_>>());
    assert!(is_readable(&page, (60, 0)));
}

/// The judge itself: letters that are small, cut off, or on each other are seen.
#[test]
fn what_cannot_be_read_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("bad.html");
    let text = "<!DOCTYPE html><html><body style=\"margin:0;background:#fff\"><p style=\"font-size:9px\">tiny</p>\
                <p style=\"position:absolute;top:100px\">one</p><p style=\"position:absolute;top:102px\">two</p>\
                <div style=\"width:2000px\">wide</div><svg class=\"chart\" viewBox=\"0 0 100 100\" width=\"100\">\
                <text x=\"90\" y=\"50\" font-size=\"12\">beyond</text></svg><img src=\"data:,\"></body></html>";
    std::fs::write(&page, text).unwrap();
    let Some((results, _)) = looked_at(&page, false) else { return println!("skipped: needs chromium") };
    let wrong = results[0]["wrong"].to_string();
    for part in [
        "\\\"tiny\\\" is 9.0 px",
        "\\\"one\\\" is under \\\"two\\\"",
        "2000 px wide",
        "\\\"beyond\\\" is cut off",
        "not use the width",
        "image",
    ] {
        assert!(wrong.contains(part), "{part} in {wrong}");
    }
}
