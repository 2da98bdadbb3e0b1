//! Nothing but `Cargo.toml`: with this dependency, a package that is built alone shares its other dependencies with the
//! programs, and none is built twice.
