//! What `memtransfer export` writes, read by the programs it is for.

use std::fs;
use std::process::Command;

use case_book::act::EpisodeParts;
use domain::prompt_log::RecordedItem;
use memtransfer_tests::{Bench, Ended, needs, program, repository};
use png_file::RgbaImage;
use run_log::step_view::{RecordedPrompt, look_up};
use serde_json::{Value, json};
use world_client::frames::{ViewFormat, ViewKey, ViewRenderer, view_arguments};
use world_client::{EpisodeTimeline, RecordedRun, WorldProgram};

use crate::python::package;

/// A small run of `policy` with `memory` in the folder `out`, of at most `steps` steps an episode.
fn small(bench: &Bench, out: &str, policy: &str, memory: &str, steps: &str) {
    let mut args = vec!["run", "--suite", "rq2", "--limit", "2", "--runs", "1"];
    args.extend(["--policy", policy, "--memory", memory, "--max-steps", steps]);
    args.extend(["--frame-size", "64", "--out", out]);
    bench.run(&args).expect(0);
}

const MEMORIES: &str = "working,episodic";

fn export(bench: &Bench, format: &str, out: &str, more: &[&str]) -> Ended {
    let args = ["export", "r", "--format", format, "--out", out];
    bench.run(&[&args[..], more].concat())
}

#[test]
fn every_format_is_read_by_the_programs_it_is_for() {
    let bench = Bench::new();
    small(&bench, "r", "grounded", MEMORIES, "40");
    let written = export(&bench, "mcap", "x/all.mcap", &["--episodes", "all", "--size", "128"]);
    assert_eq!(written.expect(0).stdout.trim(), "x/all.mcap");
    let one = ["--condition", "episodic,blocked", "--episodes", "1", "--size", "128"];
    let written = export(&bench, "mcap", "x/episodes", &one).expect(0);
    let name = written.stdout.trim().to_owned();
    assert!(name.starts_with("x/episodes/episodic_new_blocked_4_run1_t"), "{name}");
    for format in ["csv", "parquet"] {
        export(&bench, format, "x/tables", &[]).expect(0);
    }
    let recording = fs::read(bench.out("x/all.mcap")).unwrap();
    assert!(String::from_utf8_lossy(&recording).contains("grounded, scripted stand-in"));
    export(&bench, "hugging-face", "x/hub", &["--dataset", "team/memtransfer"]).expect(0);
    let mut python = Command::new(needs::exports_python());
    python.arg(repository("tests/python/read_exports.py")).args([bench.out("r"), bench.out("x")]);
    python.env("PYTHONPATH", package());
    Ended::run(&mut python).expect(0);

    // The same log gives the same files.
    let first = fs::read(bench.out("x/all.mcap")).unwrap();
    export(&bench, "mcap", "x/all.mcap", &["--episodes", "all", "--size", "128"]).expect(0);
    assert!(first == fs::read(bench.out("x/all.mcap")).unwrap());
}

#[test]
fn a_video_has_a_picture_for_every_moment() {
    let bench = Bench::new();
    small(&bench, "r", "grounded", "working", "40");
    let args = ["--size", "128", "--fps", "4", "--episodes", "2"];
    let video = export(&bench, "mp4", "video.mp4", &args).expect(0);
    assert_eq!(video.stdout.trim(), "video.mp4");
    let probe = Command::new("ffprobe")
        .args(["-v", "error", "-of", "json", "-show_entries"])
        .arg("stream=codec_name,width,height,pix_fmt,r_frame_rate,nb_frames:format_tags=comment")
        .arg(bench.out("video.mp4"))
        .output();
    let shown: Value = serde_json::from_slice(&probe.unwrap().stdout).unwrap();
    let comment = shown["format"]["tags"]["comment"].as_str().unwrap();
    assert!(comment.contains("frames rendered. Policy: grounded, scripted stand-in."), "{comment}");
    let stream = &shown["streams"][0];
    assert_eq!(stream["codec_name"], "h264");
    assert_eq!((&stream["width"], &stream["height"]), (&json!(128), &json!(128)));
    assert_eq!((&stream["pix_fmt"], &stream["r_frame_rate"]), (&json!("yuv420p"), &json!("4/1")));
    export(&bench, "csv", "tables", &["--episodes", "2"]).expect(0);
    let moments = fs::read_to_string(bench.out("tables/steps.csv")).unwrap().lines().count() - 1;
    assert_eq!(stream["nb_frames"], moments.to_string());

    let mut without = bench.command(&["export", "r", "--format", "mp4", "--out", "other.mp4"]);
    let ended = Ended::run(without.env("PATH", bench.folder.path())).expect(2);
    assert!(ended.stderr.contains("apt-get install ffmpeg"), "{}", ended.stderr);
    // Nothing is left of a failed attempt.
    assert!(!bench.out("other.mp4").exists() && !bench.out("other.mp4.part").exists());
}

#[test]
fn what_an_export_cannot_do_is_said_with_what_to_do_instead() {
    let bench = Bench::new();
    small(&bench, "r", "grounded", "working", "40");
    for (format, more, words) in [
        ("csv", &["--fps", "4"][..], "--fps is for the formats mcap and mp4"),
        (
            "hugging-face",
            &["--dataset", "a/b", "--cases", "t01"],
            "--cases is for the formats mcap, mp4, csv and parquet",
        ),
        ("mcap", &["--condition", "summary"], "none of them was chosen"),
        ("csv", &["--cases", "t99"], "t99"),
        ("hugging-face", &[], "--dataset"),
        ("hugging-face", &["--dataset", "x"], "my-team/memtransfer"),
    ] {
        let ended = export(&bench, format, "x", more).expect(2);
        assert!(ended.stderr.contains(words), "{format} {more:?}: {}", ended.stderr);
    }
    let manifest = bench.out("r/manifest.json");
    let mut json: Value = serde_json::from_str(&fs::read_to_string(&manifest).unwrap()).unwrap();
    json["episodes"] = 100.into();
    fs::write(&manifest, json.to_string()).unwrap();
    let ended = export(&bench, "hugging-face", "x", &["--dataset", "a/b"]).expect(2);
    assert!(ended.stderr.contains("complete runs only"), "{}", ended.stderr);
    assert!(!bench.out("x").exists());
}

/// What the prompt log has of every step of a short run with this control: the view that the policy was shown, and the view that
/// is exported.
fn shown_and_exported(bench: &Bench, frames: &str) -> Vec<(RecordedPrompt, RgbaImage, RgbaImage)> {
    let mut args = vec!["run", "--cases", "t03-02", "--memory", "full-context,summary"];
    args.extend(["--starts", "new", "--policy", "grounded", "--max-steps", "6", "--log-prompts"]);
    args.extend(["--frame-size", "64", "--frames", frames, "--out", frames]);
    bench.run(&args).expect(0);
    let program = WorldProgram {
        path: program("sim-proc"),
        arguments: Vec::new(),
        world_cmd: None,
        variable: ("MEMTRANSFER_TEST", "views"),
    };
    let run = RecordedRun::read(&bench.out(frames), &program.access()).unwrap();
    let RecordedRun { log, successes, world, .. } = run;
    let format = ViewFormat { edge: 64, quality: 90 };
    let mut renderer = ViewRenderer::start(&program, &view_arguments(&log), format).unwrap();
    let mut steps = Vec::new();
    for record in &log.episodes {
        let parts = EpisodeParts::default();
        let timeline = EpisodeTimeline::new(&world, record, &successes, parts).unwrap();
        for step in timeline.decisions() {
            let prompt = look_up(&log, record, step.step).unwrap().unwrap();
            let seen = RgbaImage::read(&prompt.images[&prompt.entry.request.frame]).unwrap();
            let mut exported = RgbaImage::filled(64, 64, [0; 4]);
            let copy = |_: &ViewKey, pixels: &[u8]| {
                exported.as_bytes_mut().copy_from_slice(pixels);
                Ok(())
            };
            renderer.render_pixels(std::slice::from_ref(&step.view), copy).unwrap();
            steps.push((prompt, seen, exported));
        }
    }
    assert!(steps.len() >= 6, "{} steps", steps.len());
    steps
}

#[test]
fn exports_of_a_control_show_what_the_policy_was_shown() {
    let bench = Bench::new();
    let grey = RgbaImage::filled(64, 64, [128, 128, 128, 255]);
    let mut rendered = Vec::new();
    for frames in ["rendered", "blank", "swapped", "blank-all"] {
        let steps = shown_and_exported(&bench, frames);
        let (mut supplied, mut texts) = (Vec::new(), 0);
        for (prompt, seen, exported) in &steps {
            assert!(seen == exported, "{frames}: another view is exported");
            assert_eq!(*seen == grey, frames.starts_with("blank"), "{frames}");
            for item in &prompt.entry.request.items {
                match item {
                    RecordedItem::Text { .. } => texts += 1,
                    RecordedItem::Trajectory { steps, .. } => supplied.extend(
                        prompt.trajectory(steps).iter().filter_map(|step| step.frame.clone()),
                    ),
                    _ => {}
                }
            }
            for hash in supplied.drain(..) {
                let image = RgbaImage::read(&prompt.images[&hash]).unwrap();
                assert_eq!(image == grey, frames == "blank-all", "{frames}: a view of memory");
            }
        }
        assert_eq!(texts > 0, frames != "blank-all", "{frames}: {texts} texts");
        let first = steps[0].1.clone();
        assert_eq!(rendered.contains(&first), frames == "blank-all", "{frames}");
        rendered.push(first);
        let notice = bench.run(&["score", frames]).expect(0).stdout;
        assert_eq!(notice.contains("Control: "), frames != "rendered", "{notice}");
    }
    // One is never continued with another.
    let mut args = vec!["run", "--cases", "t03-02", "--memory", "full-context,summary"];
    args.extend(["--starts", "new", "--policy", "grounded", "--max-steps", "6", "--log-prompts"]);
    args.extend(["--frame-size", "64", "--frames", "blank-all", "--out", "blank"]);
    let refused = bench.run(&args).expect(2).stderr;
    assert!(refused.contains(r#"frames: "blank" there, "blank-all" now"#), "{refused}");
    let args = ["export", "blank", "--format", "mcap", "--episodes", "1", "--out", "x.mcap"];
    let exported = bench.run(&args).expect(0);
    assert!(exported.stderr.contains("are the control `blank`"), "{}", exported.stderr);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}
