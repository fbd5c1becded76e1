//! Files made to hurt: huge, endless, deep, full of control characters. Each is refused with few, readable lines; none
//! hangs, none ends in a panic or an overflow of the stack.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::{Instance, vservo};
use std::path::Path;

/// More than this nobody reads.
const LONGEST_OUTPUT: usize = 30_000;

/// What `vservo check` says of a run file with this `text`, or of what `make` puts at its place.
fn checked_with(make: impl FnOnce(&Path), set: &[String]) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.toml");
    make(&path);
    let mut command = vservo();
    command.arg("check").arg(&path);
    for s in set {
        command.arg("--set").arg(s);
    }
    let output = command.output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(3), "{}", text.chars().take(500).collect::<String>());
    assert!(text.len() <= LONGEST_OUTPUT, "{} bytes of messages", text.len());
    assert!(text.lines().count() <= 21, "{} lines", text.lines().count());
    assert!(text.lines().all(|line| line.starts_with("vservo: ")), "{text}");
    let control = |c: char| c.is_control() && c != '\n';
    assert!(!text.contains(control), "{text:?}");
    text
}

fn checked(text: &str) -> String {
    checked_with(|path| std::fs::write(path, text).unwrap(), &[])
}

/// What `check` says of a robot file of this name and text.
fn robot(name: &str, text: &str) -> String {
    checked_with(
        |path| {
            std::fs::write(path.with_file_name(name), text).unwrap();
            std::fs::write(path, format!("[robot]\nmodel = \"{name}\"\n")).unwrap();
        },
        &[],
    )
}

fn list(count: usize, entry: impl Fn(usize) -> String, separator: &str) -> String {
    (0..count).map(entry).collect::<Vec<_>>().join(separator)
}

#[test]
fn twenty_problems_are_listed_in_order_and_the_rest_counted() {
    let text = checked(&list(20_000, |i| format!("k{i} = {i}"), "\n"));
    let lines: Vec<_> = text.lines().collect();
    assert!(lines[0].contains("run.toml:1:1: k0: unknown field `k0`, expected one of `run`"), "{text}");
    assert!(lines[19].contains("run.toml:20:1: k19: "), "{text}");
    assert!(lines[20].contains("and 19980 more problems"), "{text}");
    // Many of several kinds and tables, also in one line.
    let text = checked(&format!(
        "run = {{ seed = -1, {} }}\ngoal = {{ hold_s = 1e9, {} }}\n",
        list(30_000, |i| format!("k{i}=0"), ","),
        list(30_000, |i| format!("k{i}=0"), ",")
    ));
    assert!(text.lines().next().unwrap().contains("run.seed"), "{text}");
    assert!(text.lines().last().unwrap().contains("and 59982 more problems"), "{text}");
    let text = checked(&list(21, |i| format!("k{i} = {i}"), "\n"));
    assert!(text.lines().last().unwrap().contains("and 1 more problem;"), "{text}");
    assert_eq!(checked(&list(20, |i| format!("k{i} = {i}"), "\n")).lines().count(), 20);
}

#[test]
fn syntax_errors_without_number_are_bounded() {
    for text in [
        list(100_000, |i| format!("k{i} = "), "\n"),
        "a = 1\n".repeat(100_000),
        format!("x = [{}]", "[1, ".repeat(100_000)),
        "[".repeat(500_000),
        format!("{} = 1", vec!["a"; 300_000].join(".")),
        format!("[{}]", vec!["a"; 300_000].join(".")),
        format!("x = {}1{}", "[".repeat(300_000), "]".repeat(300_000)),
        format!("x = {}1{}", "{a=".repeat(100_000), "}".repeat(100_000)),
    ] {
        let message = checked(&text);
        assert!(message.contains("not valid TOML"), "{message}");
    }
}

#[test]
fn long_lists_and_words_are_refused_in_a_line() {
    for (key, entry) in [
        ("motion]\nmax_jerk_rad_s3_or_m_s3", "1.0"),
        ("robot]\nq_start_rad_or_m", "9e99"),
        ("servo]\nweights", "-1.0"),
        ("servo]\npoints", "0"),
        ("servo]\nsegments", "[0, 0]"),
        ("servo]\ngain_1_s", "nan"),
        ("servo.set_point]\nfeatures", "[nan, nan]"),
    ] {
        let message = checked(&format!("[{key} = [{}]\n", list(60_000, |_| entry.into(), ",")));
        assert_eq!(message.lines().count(), 1, "{message}");
        assert!(message.contains("has 60000 entries, at most"), "{message}");
    }
    let word = "w".repeat(900_000);
    let message = checked(&format!("[servo]\nscheme = \"{word}\"\n"));
    assert!(message.contains("servo.scheme: unknown variant `www"), "{message}");
    checked(&format!("{word} = 1\n"));
    checked(&format!("[robot]\nmodel = \"{word}.urdf\"\n"));
    checked(&format!("[camera]\nsource = \"replay\"\nreplay = {{ folder = \"{word}\" }}\n"));
}

#[test]
fn arguments_are_bounded_too() {
    let deep = format!("{}=1", vec!["a"; 30_000].join("."));
    let message = checked_with(|path| std::fs::write(path, "").unwrap(), &[deep]);
    assert!(message.contains("a key has at most"), "{message}");
    let many: Vec<_> = (0..2000).map(|i| format!("k{i}=1")).collect();
    let message = checked_with(|path| std::fs::write(path, "").unwrap(), &many);
    assert!(message.contains("and 1980 more problems"), "{message}");
}

#[test]
fn only_regular_files_of_a_sane_size_are_read() {
    let big = "# a comment\n".repeat(100_000);
    assert!(checked(&big).contains("run.toml: cannot be read: it is larger than 1 MiB"));
    let fifo = |path: &Path| {
        assert!(std::process::Command::new("mkfifo").arg(path).status().unwrap().success());
    };
    assert!(checked_with(fifo, &[]).contains("run.toml: cannot be read: it is not a regular file"));
    let device = |to: &'static str| move |path: &Path| std::os::unix::fs::symlink(to, path).unwrap();
    for to in ["/dev/zero", "/dev/null", "/dev/tty", "/dev"] {
        let message = checked_with(device(to), &[]);
        assert!(message.contains("run.toml: cannot be read: it is not a regular file"), "{to}: {message}");
    }
    let binary = |path: &Path| std::fs::write(path, [0xff, 0xfe, 0x00]).unwrap();
    assert!(checked_with(binary, &[]).contains("it is not text in UTF-8"));

    for name in ["arm.toml", "arm.urdf"] {
        let place = |path: &Path, make: &dyn Fn(&Path)| {
            std::fs::write(path, format!("[robot]\nmodel = \"{name}\"\n")).unwrap();
            make(&path.with_file_name(name));
        };
        let message = checked_with(|path| place(path, &fifo), &[]);
        assert!(message.contains("it is not a regular file"), "{message}");
        let message = checked_with(|path| place(path, &|p| device("/dev/zero")(p)), &[]);
        assert!(message.contains("it is not a regular file"), "{message}");
        let large = |path: &Path| std::fs::write(path, vec![b'\n'; 9 << 20]).unwrap();
        let message = checked_with(|path| place(path, &large), &[]);
        assert!(message.contains("it is larger than"), "{message}");
    }
    // A robot file that names a pipe as its URDF.
    let message = checked_with(
        |path| {
            std::fs::write(path, "[robot]\nmodel = \"arm.toml\"\n").unwrap();
            std::fs::write(path.with_file_name("arm.toml"), "name = 'a'\n[urdf]\nfile = 'arm.urdf'\n")
                .unwrap();
            fifo(&path.with_file_name("arm.urdf"));
        },
        &[],
    );
    assert!(message.contains("arm.urdf") && message.contains("it is not a regular file"), "{message}");
}

#[test]
fn control_characters_of_the_input_are_escaped() {
    let message = checked("\"\\u001b[2J\\nvservo: all is well\" = 1\n");
    assert!(message.contains("\\u{1b}[2J\\nvservo: all is well"), "{message}");
    assert_eq!(message.lines().count(), 1, "{message}");
    checked("[servo]\nscheme = \"\\u001b]0;title\\u0007\\u009b1m\\u202e\"\n");
    checked("[robot]\nmodel = \"a\\u001b[31m\\n.urdf\"\n");
    robot("arm.toml", "name = \"\\u001b[31m\\r\\n\"\n");
    robot("arm.toml", "\"\\u001b[31m\\n\" = 1\n");
    robot("arm.urdf", "<robot name='r'><link name='\u{1b}[31m&#10;'></robot>");
    robot("arm.urdf", "<robot name='r'><link name='a\u{85}\n b'/><link name='a\u{85}\n b'/></robot>");
    // Also where the file itself is called so, and in what is not a configuration.
    let name = "\u{1b}[31m\nvservo: fine.toml";
    let output = vservo().args(["check", name]).output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(text.contains("\\u{1b}[31m\\nvservo: fine.toml") && text.lines().count() == 1, "{text:?}");
    let output = vservo().args(["run", "--instance", "a\u{1b}[31m\nb"]).output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!text.contains('\u{1b}') && text.lines().count() == 1, "{text:?}");
}

#[test]
fn the_name_of_a_sound_robot_is_escaped_too() {
    let folder = tempfile::tempdir().unwrap();
    let scara = include_str!("../../config/robot/scara.toml");
    let arm = scara.replace("name = \"scara\"", "name = \"\\u001b[31m\\nscara\"");
    std::fs::write(folder.path().join("arm.toml"), arm).unwrap();
    let path = folder.path().join("run\u{1b}.toml");
    std::fs::write(&path, "robot.model = \"arm.toml\"\n").unwrap();
    let output = vservo().arg("check").arg(&path).output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success() && !text.contains('\u{1b}'), "{text:?}");
    let first = text.lines().next().unwrap();
    assert!(
        first.contains("run\\u{1b}.toml: ok:") && first.contains("on \\u{1b}[31m\\nscara, 640x480"),
        "{text:?}"
    );
}

#[test]
fn robot_tables_without_end() {
    let row = "[[dh.joint]]\nname = 'j'\ntype = 'revolute'\nlimits = { lower_rad = -1, upper_rad = 1, velocity_rad_s = 1, \
               effort_n_m = 1 }\nlink = { mass_kg = 1, inertia_kg_m2 = { xx = 1, yy = 1, zz = 1 } }\n";
    let message =
        robot("arm.toml", &format!("name = 'a'\n[dh]\nconvention = 'standard'\n{}", row.repeat(4_000)));
    assert!(message.contains("4000 moving joints"), "{message}");
    robot("arm.toml", &list(50_000, |i| format!("k{i} = {i}"), "\n"));
    robot("arm.toml", &format!("name = 'a'\ngravity_m_s2 = [{}]\n", list(100_000, |_| "1".into(), ",")));
    robot("arm.toml", &format!("{} = 1", vec!["a"; 300_000].join(".")));
    robot("arm.toml", &"a = 1\n".repeat(100_000));
}

#[test]
fn urdfs_deep_long_and_wide() {
    let message = robot(
        "arm.urdf",
        &format!("<robot name='r'>{}{}</robot>", "<a>".repeat(12_000), "</a>".repeat(12_000)),
    );
    assert!(message.contains("arm.urdf:1: ") && message.contains("nested more than"), "{message}");
    let visual = "<visual>".repeat(12_000) + &"</visual>".repeat(12_000);
    let message = robot("arm.urdf", &format!("<robot name='r'>\n<link name='a'>{visual}</link></robot>"));
    assert!(message.contains("arm.urdf:2: ") && message.contains("nested more than"), "{message}");
    let message = robot("arm.urdf", &"<robot>\n".repeat(500_000));
    assert!(message.contains("nested more than"), "{message}");

    let chain = |count: usize| {
        let links = list(count + 1, |i| format!("<link name='l{i}'/>"), "\n");
        let joint = |i: usize| {
            format!("<joint name='j{i}' type='fixed'><parent link='l{i}'/><child link='l{}'/></joint>", i + 1)
        };
        format!("<robot name='r'>{links}{}</robot>", list(count, joint, "\n"))
    };
    let message = robot("arm.urdf", &chain(20_000));
    assert!(message.contains("more than"), "{message}");
    let message = robot("arm.urdf", &chain(900));
    assert!(message.contains("0 moving joints"), "{message}");

    let message = robot("arm.urdf", &format!("<robot name='r'>{}</robot>", "<a/>".repeat(400_000)));
    assert!(message.contains("elements"), "{message}");
    let attributes = list(100_000, |i| format!("a{i}='1'"), " ");
    let message = robot("arm.urdf", &format!("<robot name='r'><link {attributes}/></robot>"));
    assert!(message.contains("tag"), "{message}");
    robot("arm.urdf", &format!("<robot name='{}'/>", "n".repeat(1_000_000)));
    robot("arm.urdf", &format!("<robot name='r'>{}</robot>", "<!-- -->".repeat(300_000)));
    robot("arm.urdf", &format!("<robot name='r'>{}", "<".repeat(500_000)));
    robot("arm.urdf", &format!("<robot name='r'>{}", "<a b='".repeat(500_000)));
    robot("arm.urdf", &format!("<robot name='r'>{}", "&amp;".repeat(500_000)));
}

/// A run file named without a folder stands in the working directory, with an external drive too.
#[test]
fn a_run_file_named_without_a_folder() {
    let folder = tempfile::tempdir().unwrap();
    let text = "[drive]\nkind = 'external'\nexternal = { command = ['true'] }\n";
    std::fs::write(folder.path().join("run.toml"), text).unwrap();
    let output = vservo().args(["check", "run.toml"]).current_dir(folder.path()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let instance = Instance::new("bare");
    let set = ["--set", "drive.external.command=['no-such-program']", "--instance", &instance.name];
    let output = vservo().args(["run", "run.toml"]).args(set).current_dir(folder.path()).output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(message.contains("cannot start `no-such-program`"), "{message}");
    instance.assert_gone();
}
