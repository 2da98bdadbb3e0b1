use warehouse::*;
fn main() {
    let a: Vec<usize> = std::env::args().skip(1).map(|a| a.parse().unwrap()).collect();
    let world = GeneratedWorld::generate(a[2] as u64, a[0], a[1], None).unwrap();
    let c = CaseSet::generate(&world.warehouse, a[2] as u64, 50);
    println!("{}", c.is_ok());
}
