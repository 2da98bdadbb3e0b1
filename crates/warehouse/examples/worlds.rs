//! Generates 200 warehouses of 20 sizes with 50 cases each, validates them, and prints what it took.
//!
//! Seconds are processor time of one core. The peak is that of the process so far, so sizes are sorted. Arguments: seeds for
//! each size (10), cases (50). Exit status 1 when a world cannot be generated or a constraint is violated.

use std::process::ExitCode;

use warehouse::{CaseSet, GeneratedWorld, validate};

const SIZES: [(usize, usize); 20] = [
    (12, 12),
    (12, 13),
    (14, 12),
    (13, 17),
    (16, 16),
    (12, 24),
    (24, 14),
    (16, 30),
    (20, 24),
    (12, 64),
    (64, 12),
    (24, 40),
    (40, 25),
    (32, 32),
    (21, 63),
    (37, 43),
    (64, 30),
    (48, 48),
    (56, 52),
    (64, 64),
];

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1).map_while(|argument| argument.parse().ok());
    let seeds = arguments.next().unwrap_or(10);
    let count = arguments.next().unwrap_or(50);
    let (mut worlds, mut failed) = (0, 0);
    println!("size     free cells  items  generate s (max)  validate s  peak MiB");
    for (width, height) in SIZES {
        let (mut generating, mut longest, mut validating) = (0.0, 0.0_f64, 0.0);
        let (mut cells, mut items) = (0, 0);
        for seed in 1..=seeds {
            let start = processor_seconds();
            let generated =
                GeneratedWorld::generate(seed as u64, width, height, None).and_then(|world| {
                    let cases = CaseSet::generate(&world.warehouse, seed as u64, count)?;
                    Ok((world.warehouse, cases))
                });
            let (warehouse, cases) = match generated {
                Ok(generated) => generated,
                Err(error) => {
                    println!("{width}x{height} seed {seed}: {error}");
                    failed += 1;
                    continue;
                }
            };
            let middle = processor_seconds();
            let report = validate(&warehouse, &cases);
            if !report.is_clean() {
                println!("{width}x{height} seed {seed}:\n{report}");
                failed += 1;
            }
            worlds += 1;
            generating += middle - start;
            longest = longest.max(middle - start);
            validating += processor_seconds() - middle;
            cells += warehouse.layout.free_cells().count();
            items += warehouse.items.len();
        }
        let size = format!("{width}x{height}");
        println!(
            "{size:<8} {:>10} {:>6} {:>10.2} ({longest:.2}) {:>11.2} {:>9}",
            cells / seeds,
            items / seeds,
            generating / seeds as f64,
            validating / seeds as f64,
            peak_mib()
        );
    }
    println!("{worlds} worlds, {count} cases each, {failed} failed");
    if failed == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Time that this thread was on a processor; 0 where the system does not say.
fn processor_seconds() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanoseconds = text.split(' ').next().and_then(|field| field.parse::<f64>().ok());
    nanoseconds.unwrap_or(0.0) / 1e9
}

/// Peak resident memory of this process; 0 where the system does not say.
fn peak_mib() -> u64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = text.lines().find(|line| line.starts_with("VmHWM:"));
    let kib = line.and_then(|line| line.split_whitespace().nth(1)?.parse::<u64>().ok());
    kib.unwrap_or(0) / 1024
}
