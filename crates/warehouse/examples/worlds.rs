//! scratch
use std::time::Instant;
use warehouse::*;
fn main() {
    let mut args = std::env::args().skip(1);
    let (w, h): (usize, usize) = (args.next().unwrap().parse().unwrap(), args.next().unwrap().parse().unwrap());
    let from: u64 = args.next().unwrap().parse().unwrap();
    let to: u64 = args.next().unwrap().parse().unwrap();
    let count: usize = args.next().unwrap().parse().unwrap();
    for seed in from..to {
        let world = GeneratedWorld::generate(seed, w, h, None).unwrap();
        if to - from == 1 { println!("{}\n{}", world.layout.split("[[").next().unwrap(), world.catalogue.split("[[").next().unwrap()); }
        let start = Instant::now();
        let warehouse = &world.warehouse;
        let cases = CaseSet::generate(warehouse, seed, count);
        println!("{w}x{h} seed {seed}: {} items {} categories {:?} {}", warehouse.items.len(), warehouse.catalogue.categories.len(), start.elapsed(), match cases { Ok(_) => "ok".to_string(), Err(e) => e.to_string() });
    }
}
