//! The machine: what it is ([`Machine`]), and what it achieves at best ([`floors`]). `memtransfer profile` and the
//! benches record both with their figures.

pub mod floors;

use std::fs;
use std::path::Path;

use serde::{Deserialize, Serialize};

/// Instruction sets that matter to speed.
const FLAGS: [&str; 11] = [
    "avx2",
    "fma",
    "f16c",
    "avx512f",
    "avx512bw",
    "avx512_vnni",
    "avx512_bf16",
    "avx512_fp16",
    "amx_tile",
    "amx_int8",
    "amx_bf16",
];

/// The properties of a machine that determine how fast a program runs on it.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Machine {
    /// The processor's name.
    pub processor: String,
    /// Cores available to this process.
    pub cores: u32,
    /// Its instruction sets that matter to speed.
    pub flags: Vec<String>,
    /// Bytes of memory.
    pub memory_bytes: u64,
    /// Bytes of shared memory.
    pub shared_memory_bytes: u64,
    /// The kernel's version.
    pub kernel: String,
    /// Whether it is a virtual machine.
    pub is_virtual: bool,
    /// NVIDIA GPUs, by name.
    pub gpus: Vec<String>,
}

impl Machine {
    /// This machine. What the system does not tell is left empty.
    pub fn here() -> Self {
        let text = |path: &str| fs::read_to_string(path).unwrap_or_default();
        let (processors, memory) = (text("/proc/cpuinfo"), text("/proc/meminfo"));
        let has = field(&processors, "flags").unwrap_or_default();
        let has = |flag: &str| has.split_whitespace().any(|word| word == flag);
        Self {
            processor: field(&processors, "model name").unwrap_or_default().to_owned(),
            cores: std::thread::available_parallelism().map_or(1, |cores| cores.get() as u32),
            flags: FLAGS.into_iter().filter(|flag| has(flag)).map(str::to_owned).collect(),
            memory_bytes: kibibytes(&memory, "MemTotal").unwrap_or_default(),
            shared_memory_bytes: shm_types::process::shared_memory_space()
                .map_or(0, |(_, all)| all),
            kernel: text("/proc/sys/kernel/osrelease").trim().to_owned(),
            is_virtual: has("hypervisor"),
            gpus: gpus(Path::new("/proc/driver/nvidia/gpus")),
        }
    }

    /// A description in one line.
    pub fn summary(&self) -> String {
        let gib = |bytes: u64| format!("{:.0} GiB", bytes as f64 / (1_u64 << 30) as f64);
        let cores =
            if self.cores == 1 { "1 core".to_owned() } else { format!("{} cores", self.cores) };
        let gpus = if self.gpus.is_empty() { "no GPU".to_owned() } else { self.gpus.join(", ") };
        format!(
            "{}{}, {cores}, {} of memory, {} of shared memory, {gpus}, Linux {}; {}",
            self.processor,
            if self.is_virtual { " (virtual)" } else { "" },
            gib(self.memory_bytes),
            gib(self.shared_memory_bytes),
            self.kernel,
            self.flags.join(" ")
        )
    }

    /// The processor and its instruction sets: what floating-point results may depend on.
    pub fn processor_and_flags(&self) -> String {
        format!("{}; {}", self.processor, self.flags.join(" "))
    }
}

/// Bytes of available memory; `u64::MAX` where the system does not tell.
pub fn memory_available() -> u64 {
    let memory = fs::read_to_string("/proc/meminfo").unwrap_or_default();
    kibibytes(&memory, "MemAvailable").unwrap_or(u64::MAX)
}

/// Bytes in a line of /proc/meminfo, which has KiB.
fn kibibytes(memory: &str, name: &str) -> Option<u64> {
    let kib: u64 = field(memory, name)?.split(' ').next()?.parse().ok()?;
    kib.checked_mul(1024)
}

/// The value of the first line `name : value`.
fn field<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    text.lines()
        .filter_map(|line| line.split_once(':'))
        .find(|(key, _)| key.trim() == name)
        .map(|(_, value)| value.trim())
}

/// The names of the GPUs in NVIDIA's part of /proc, which has a folder for each.
fn gpus(folder: &Path) -> Vec<String> {
    let folders = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut names: Vec<String> = folders
        .filter_map(|gpu| fs::read_to_string(gpu.path().join("information")).ok())
        .filter_map(|text| field(&text, "Model").map(str::to_owned))
        .collect();
    names.sort();
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_found_by_name() {
        let text = "model name\t: A: b\nMemTotal:   12 kB\n";
        assert_eq!(
            (field(text, "model name"), field(text, "MemTotal")),
            (Some("A: b"), Some("12 kB"))
        );
        assert_eq!(field(text, "model"), None);
        assert_eq!(kibibytes(text, "MemTotal"), Some(12 << 10));
        assert_eq!(kibibytes(text, "model name"), None);
    }

    #[test]
    fn this_machine_describes_itself() {
        let here = Machine::here();
        assert!(here.cores > 0 && here.memory_bytes > 0 && !here.kernel.is_empty());
        assert!(here.summary().contains(&here.kernel));
        let text = serde_json::to_string(&here).unwrap();
        assert_eq!(serde_json::from_str::<Machine>(&text).unwrap(), here);
    }

    #[test]
    fn gpus_are_listed_by_the_driver_s_name() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("0000:01:00.0")).unwrap();
        fs::write(folder.path().join("0000:01:00.0/information"), "Model: \t\t Some GPU\nIRQ: 1\n")
            .unwrap();
        assert_eq!(gpus(folder.path()), ["Some GPU"]);
        assert_eq!(gpus(&folder.path().join("none")), [""; 0]);
    }
}
