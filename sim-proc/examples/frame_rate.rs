//! Prints how many views per second the renderer draws, over every pose of the warehouse.
//!
//!     cargo run --release -p sim-proc --example frame_rate -- [rounds] [samples] [cpu | part of an adapter's name]
//!
//! Views are rendered into page-aligned memory of this process; hashing and publishing are not measured.

use std::time::{Duration, Instant};

use anyhow::Result;
use domain::Pose;
use sim_proc::renderer::{
    Backend, Destination, RenderJob, RenderSettings, Renderer, Samples, ViewSpec,
};
use warehouse::{Variant, Warehouse, every_pose};

const PAGE: usize = 4096;

static UNCHANGED: Variant = Variant::UNCHANGED;

fn main() -> Result<()> {
    let rounds: u32 = std::env::args().nth(1).map_or(Ok(3), |text| text.parse())?;
    let warehouse = Warehouse::shipped();
    let poses: Vec<Pose> = every_pose(&warehouse.layout).collect();
    let only: Option<u32> = std::env::args().nth(2).map(|text| text.parse()).transpose()?;
    let backend = std::env::args().nth(3);
    let (backend, adapter) = match backend.as_deref() {
        Some("cpu") => (Some(Backend::Cpu), None),
        adapter => (None, adapter.map(str::to_owned)),
    };
    for samples in [Samples::One, Samples::Four] {
        if only.is_some_and(|only| only != samples.count()) {
            continue;
        }
        for batch in [1, 8] {
            let begun = Instant::now();
            let adapter = adapter.clone();
            let settings =
                RenderSettings { samples, backend, adapter, ..RenderSettings::default() };
            let mut renderer = Renderer::new(&warehouse, settings)?;
            let start = begun.elapsed();
            let mut times = Vec::new();
            let cpu = cpu_time();
            for _ in 0..rounds {
                times.push(all_poses(&mut renderer, &poses, batch)?);
            }
            let cpu = (cpu_time() - cpu) / (rounds * poses.len() as u32);
            let best = times.iter().min().copied().unwrap_or(Duration::MAX);
            println!(
                "{} sample(s), batches of {batch}: {:.0} views per second at best, {:.0} in the first \
                 round; {:.2} ms of CPU time per view; start {:.0} ms; {}",
                samples.count(),
                poses.len() as f64 / best.as_secs_f64(),
                poses.len() as f64 / times[0].as_secs_f64(),
                cpu.as_secs_f64() * 1e3,
                start.as_secs_f64() * 1e3,
                renderer.report().adapter.as_deref().unwrap_or("cpu"),
            );
        }
    }
    Ok(())
}

/// The CPU time of all threads of this process.
fn cpu_time() -> Duration {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    Duration::new(now.tv_sec as u64, now.tv_nsec as u32)
}

/// Draws every pose once and returns how long that took.
fn all_poses(renderer: &mut Renderer, poses: &[Pose], batch: usize) -> Result<Duration> {
    let bytes = renderer.frame_bytes().next_multiple_of(PAGE);
    let mut memory = vec![0_u8; bytes * batch + PAGE];
    let offset = memory.as_ptr().align_offset(PAGE);
    let pages = &mut memory[offset..][..bytes * batch];
    renderer.forget_imports();
    let begun = Instant::now();
    for poses in poses.chunks(batch) {
        let mut jobs: Vec<RenderJob<'_>> = poses
            .iter()
            .zip(pages.chunks_exact_mut(bytes))
            .map(|(&pose, slot)| RenderJob {
                view: ViewSpec { pose, variant: &UNCHANGED, stock: 0 },
                destination: Destination::Slot(slot),
            })
            .collect();
        renderer.render(&mut jobs)?;
    }
    Ok(begun.elapsed())
}
