//! Draws a trace (`memtransfer run --trace`) as SVG: one row per track.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, anyhow, ensure};
use orchestrator::trace::FIRST_LANE;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use serde::Deserialize;
use serde_json::Value;

/// Width of the image, left edge of the rows, and height of a row, in pixels.
const WIDTH: u32 = 1000;
const LEFT: i32 = 170;
const ROW: i32 = 34;
const AXIS: i32 = 40;

/// One colour per process, distinguishable in grey.
const COLOURS: [RGBColor; 4] = [
    RGBColor(0x44, 0x44, 0x44),
    RGBColor(0x1f, 0x77, 0xb4),
    RGBColor(0xd9, 0x8c, 0x1a),
    RGBColor(0x2c, 0xa0, 0x2c),
];

/// A trace, reduced to what is drawn.
#[derive(Debug, Deserialize)]
struct Trace {
    #[serde(rename = "traceEvents")]
    events: Vec<Event>,
}

#[derive(Debug, Deserialize)]
struct Event {
    ph: String,
    name: String,
    pid: u32,
    tid: u32,
    #[serde(default)]
    ts: f64,
    #[serde(default)]
    dur: f64,
    #[serde(default)]
    args: Value,
}

/// Start and end of a slice, in milliseconds.
type Piece = (f64, f64);

/// Draws `for_ms` milliseconds of the file `trace`, starting at `from_ms`.
///
/// # Errors
/// When the file cannot be read, is not a trace, or has no slice in that time.
pub fn draw(trace: &Path, from_ms: f64, for_ms: f64) -> Result<String> {
    let text = std::fs::read_to_string(trace)
        .with_context(|| format!("cannot read {}", trace.display()))?;
    let trace: Trace = serde_json::from_str(&text).with_context(|| {
        format!("{} is not what `memtransfer run --trace` writes", trace.display())
    })?;
    let rows = rows(&trace, (from_ms, from_ms + for_ms));
    ensure!(
        rows.values().any(|pieces| !pieces.is_empty()),
        "nobody worked from {from_ms} ms on for {for_ms} ms"
    );
    paint(&rows, (from_ms, from_ms + for_ms)).map_err(|error| anyhow!("cannot draw: {error}"))
}

/// Slices of that time by process and track, with their names.
fn rows(trace: &Trace, (from, until): (f64, f64)) -> BTreeMap<(u32, u32, String), Vec<Piece>> {
    let named = |what: &str, pid: u32, tid: Option<u32>| {
        let is_it = |event: &&Event| {
            event.name == what && event.pid == pid && tid.is_none_or(|tid| event.tid == tid)
        };
        let event = trace.events.iter().find(is_it);
        event.and_then(|event| event.args["name"].as_str()).unwrap_or("?").to_owned()
    };
    let mut tracks: BTreeMap<(u32, u32), Vec<Piece>> = BTreeMap::new();
    for event in trace.events.iter().filter(|event| event.ph == "X" && event.tid < FIRST_LANE) {
        let piece = (event.ts / 1000.0, (event.ts + event.dur) / 1000.0);
        let pieces = tracks.entry((event.pid, event.tid)).or_default();
        if piece.1 > from && piece.0 < until {
            pieces.push((piece.0.max(from), piece.1.min(until)));
        }
    }
    let name = |pid, tid| {
        let (process, track) =
            (named("process_name", pid, None), named("thread_name", pid, Some(tid)));
        if process == track { process } else { format!("{process}: {track}") }
    };
    tracks.into_iter().map(|((pid, tid), pieces)| ((pid, tid, name(pid, tid)), pieces)).collect()
}

fn paint(
    rows: &BTreeMap<(u32, u32, String), Vec<Piece>>,
    (from, until): (f64, f64),
) -> Result<String, Box<dyn std::error::Error>> {
    let mut svg = String::new();
    let height = AXIS + ROW * rows.len() as i32;
    {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, height as u32)).into_drawing_area();
        area.fill(&WHITE)?;
        let across = f64::from(WIDTH as i32 - LEFT - 30);
        let x = |ms: f64| LEFT + ((ms - from) / (until - from) * across) as i32;
        let words = |size| ("sans-serif", size).into_font().color(&BLACK);
        for ((place, ((pid, _, name), pieces)), top) in
            (0..).zip(rows).zip((0..).step_by(ROW as usize))
        {
            if place % 2 == 0 {
                let stripe = RGBColor(0xf4, 0xf4, 0xf4).filled();
                area.draw(&Rectangle::new([(0, top), (WIDTH as i32, top + ROW)], stripe))?;
            }
            let right = Pos::new(HPos::Right, VPos::Center);
            let at = (LEFT - 10, top + ROW / 2);
            area.draw(&Text::new(name.as_str(), at, words(15).pos(right)))?;
            let colour = COLOURS[(*pid as usize).saturating_sub(1) % COLOURS.len()];
            for &(start, end) in pieces {
                // A slice too short to see is a line.
                let end = x(end).max(x(start) + 1);
                let corners = [(x(start), top + 6), (end, top + ROW - 6)];
                area.draw(&Rectangle::new(corners, colour.filled()))?;
            }
        }
        let bottom = height - AXIS;
        for tick in 0..=5 {
            let ms = from + (until - from) * f64::from(tick) / 5.0;
            area.draw(&PathElement::new([(x(ms), bottom), (x(ms), bottom + 5)], BLACK))?;
            let middle = words(14).pos(Pos::new(HPos::Center, VPos::Top));
            area.draw(&Text::new(format!("{ms:.0} ms"), (x(ms), bottom + 10), middle))?;
        }
        area.present()?;
    }
    Ok(svg)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_is_drawn_a_row_for_each_track_and_steps_are_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.json");
        let trace = r#"{"traceEvents":[
            {"ph":"X","name":"draw","pid":2,"tid":1,"ts":1000.0,"dur":2000.0,"args":{"count":8}},
            {"ph":"X","name":"embed","pid":3,"tid":1,"ts":1500.0,"dur":9000.0,"args":{"count":1}},
            {"ph":"X","name":"step","pid":1,"tid":100,"ts":1500.0,"dur":9000.0,"args":{}},
            {"ph":"M","name":"process_name","pid":2,"tid":0,"args":{"name":"sim"}},
            {"ph":"M","name":"thread_name","pid":2,"tid":1,"args":{"name":"renderer"}}]}"#;
        std::fs::write(&path, trace).unwrap();
        let svg = draw(&path, 0.0, 10.0).unwrap();
        assert!(svg.contains("sim: renderer") && svg.contains("10 ms"), "{svg}");
        let drawn: Trace = serde_json::from_str(trace).unwrap();
        let rows = rows(&drawn, (2.0, 10.0));
        assert_eq!(rows.values().flatten().collect::<Vec<_>>(), [&(2.0, 3.0), &(2.0, 10.0)]);
        assert!(draw(&path, 20.0, 10.0).unwrap_err().to_string().contains("nobody worked"));
        std::fs::write(&path, "[]").unwrap();
        assert!(draw(&path, 0.0, 10.0).is_err());
    }
}
