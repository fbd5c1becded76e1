//! Every command of the documentation runs, and ends well: the blocks marked `sh` of README.md, docs/ and python/README.md, each in a
//! folder of its own that holds the sources' `config` and `examples`. Blocks marked `console` need what is not everywhere: a camera,
//! several terminals, a long build.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // helpers of tests; what ran is told

use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Languages that a block may be marked with.
const LANGUAGES: [&str; 7] = ["sh", "console", "text", "toml", "ini", "json", "python"];

/// Lets `vservo` stand for the built program, with an instance of this test's own, and runs in simulated time, so that a loaded machine
/// changes nothing. Commands of cargo are the business of others.
const PRELUDE: &str = r#"
set -euo pipefail
vservo() {
    case "${1:-}" in
        run) has_clock "$@" || set -- "$@" --clock lockstep; command vservo "$@" --instance "$VSERVO_TEST_INSTANCE" ;;
        calibrate)
            if [ "${2:-}" = latency ] || [ "${2:-}" = load ]; then set -- "$@" --clock lockstep --instance "$VSERVO_TEST_INSTANCE"; fi
            command vservo "$@" ;;
        *) command vservo "$@" ;;
    esac
}
has_clock() { case " $* " in *" --clock "*) return 0 ;; *) return 1 ;; esac; }
cargo() { :; }
"#;

struct Block {
    file: String,
    line: usize,
    language: String,
    text: String,
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn documents() -> Vec<PathBuf> {
    let mut all = vec![root().join("README.md"), root().join("python/README.md")];
    let docs = std::fs::read_dir(root().join("docs")).unwrap().map(|entry| entry.unwrap().path());
    all.extend(docs.filter(|path| path.extension().is_some_and(|e| e == "md")));
    all.sort();
    all
}

fn blocks(path: &Path) -> Vec<Block> {
    let text = std::fs::read_to_string(path).unwrap();
    let file = path.strip_prefix(root()).unwrap().display().to_string();
    let (mut blocks, mut open): (Vec<Block>, bool) = (Vec::new(), false);
    for (line, content) in (1..).zip(text.lines()) {
        if let Some(language) = content.strip_prefix("```") {
            if !open {
                let (file, language) = (file.clone(), language.to_owned());
                blocks.push(Block { file, line, language, text: String::new() });
            }
            open = !open;
        } else if let Some(block) = blocks.last_mut().filter(|_| open) {
            block.text += content;
            block.text.push('\n');
        }
    }
    assert!(!open, "{file}: a block is not closed");
    blocks
}

#[test]
fn every_block_says_what_it_is_and_every_link_leads_somewhere() {
    for path in documents() {
        for block in blocks(&path) {
            let known = LANGUAGES.contains(&block.language.as_str());
            assert!(known, "{}:{}: a block marked `{}`", block.file, block.line, block.language);
        }
        let text = std::fs::read_to_string(&path).unwrap();
        for (at, _) in text.match_indices("](") {
            let target = text[at + 2..].split([')', '#']).next().unwrap();
            if !target.is_empty() && !target.contains("://") {
                let there = path.parent().unwrap().join(target);
                assert!(there.exists(), "{}: links to {target}", path.display());
            }
        }
    }
}

#[test]
fn every_command_of_the_documentation_ends_well() {
    let program = Path::new(env!("CARGO_BIN_EXE_vservo"));
    let search = format!("{}:{}", program.parent().unwrap().display(), std::env::var("PATH").unwrap());
    let mut count = 0;
    let mut wrong = Vec::new();
    for path in documents() {
        // blocks of one document build on each other
        let folder = tempfile::tempdir().unwrap();
        for shared in ["config", "examples"] {
            symlink(root().join(shared), folder.path().join(shared)).unwrap();
        }
        for block in blocks(&path).iter().filter(|block| block.language == "sh") {
            if block
                .text
                .lines()
                .all(|line| line.starts_with("cargo ") || line.contains("pip ") || line.contains("venv"))
            {
                continue;
            }
            count += 1;
            let output = Command::new("bash")
                .args(["-c", &format!("{PRELUDE}{}", block.text)])
                .current_dir(folder.path())
                .env("PATH", &search)
                .env("VSERVO_TEST_INSTANCE", format!("docs-{}-{count}", std::process::id()))
                .stdin(Stdio::null())
                .output()
                .expect("bash");
            if !output.status.success() {
                let said = String::from_utf8_lossy(&output.stderr).into_owned();
                let last: Vec<_> = said.lines().rev().take(5).collect();
                wrong.push(format!("{}:{}: {}: {last:?}", block.file, block.line, output.status));
            }
        }
    }
    println!("{count} blocks ran");
    assert!(wrong.is_empty(), "{wrong:#?}");
    assert!(count > 10, "{count}");
}
