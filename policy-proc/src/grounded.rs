mod instruction;
mod plates;
#[cfg(test)]
mod painter;
