//! The program `memtransfer`: cases, conditions, lanes, scoring, logs, command line.
