//! What a measurement was taken on, and how much of the processor it took.

use std::time::Duration;

/// Processor, cores, system and version: facts without which a time means nothing.
pub fn facts() -> Vec<(&'static str, String)> {
    let cpuinfo = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = cpuinfo.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": "));
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    vec![
        ("processor", model.map_or("unknown", |(_, name)| name).to_owned()),
        ("cores", cores.to_string()),
        ("system", format!("{} {}", std::env::consts::OS, std::env::consts::ARCH)),
        ("rigel", env!("CARGO_PKG_VERSION").to_owned()),
        ("build", if cfg!(debug_assertions) { "test profile" } else { "release" }.to_owned()),
    ]
}

/// What this process has used so far on all cores, from the system's own count of hundredths of a second; zero where
/// it does not tell (elsewhere than on Linux).
pub fn cpu_time() -> Duration {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    let ticks = |index: usize| fields.get(index).and_then(|field| field.parse::<u64>().ok()).unwrap_or(0);
    Duration::from_millis(10 * (ticks(11) + ticks(12)))
}

/// CPU seconds that one call of `work` takes: the mean over as many calls as fill `at_least`, so that the clock's hundredths
/// do not matter.
pub fn cpu_seconds<T>(at_least: Duration, mut work: impl FnMut() -> T) -> (f64, T) {
    let start = cpu_time();
    let wall = std::time::Instant::now();
    let mut calls = 0;
    loop {
        let result = work();
        calls += 1;
        let used = cpu_time() - start;
        if used >= at_least || wall.elapsed() > 20 * at_least {
            return (used.as_secs_f64() / f64::from(calls), result);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn facts_are_known_and_work_is_done() {
        assert_eq!(cpu_seconds(Duration::from_millis(1), || 7).1, 7);
        assert!(facts().iter().all(|(_, value)| !value.is_empty()));
    }
}
