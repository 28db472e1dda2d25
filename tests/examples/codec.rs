//! What the codec and the conversation cost: `cargo run --release -p rigel-tests --example codec`.
//!
//! Throughput of encoding and decoding in memory, wall time and this process' own CPU time; and how long the simulated rig
//! behind a pseudo-terminal takes to answer.

use std::time::{Duration, Instant};

use rigel::rig::SerialRig;
use rigel_protocol::{Answer, Decoder, LARGEST_FRAME, Orientation, Record, Reply, encode, frame};
use rigel_simulated::rig::{RigOptions, SimulatedRig};

const FRAMES: u32 = 1_000_000;
const QUESTIONS: usize = 5_000;

fn record(count: u32) -> Answer {
    let n = count as i32;
    Answer {
        sequence: 9,
        reply: Reply::Record(Record {
            count,
            at_us: u64::from(count) * 16_667,
            station: 1,
            status: b' ',
            position_um: [n % 300_000, 150_000 - n % 1_000, -n % 90_000],
            orientation: Orientation::Quaternion([707_107, n % 707_107, -n % 5_000, 0]),
        }),
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut bytes = Vec::with_capacity(64 * FRAMES as usize);
    let mut buffer = [0; LARGEST_FRAME];
    let (start, cpu) = (Instant::now(), cpu_time());
    for count in 0..FRAMES {
        bytes.extend_from_slice(encode(&record(count), &mut buffer)?);
    }
    report("encoded", start.elapsed(), cpu_time() - cpu, bytes.len());

    let (mut decoder, mut heard) = (Decoder::new(), 0);
    let (start, cpu) = (Instant::now(), cpu_time());
    for &byte in &bytes {
        if let Some(payload) = decoder.push(byte) {
            heard += u32::from(frame::decode::<Answer>(payload?)?.sequence == 9);
        }
    }
    report("decoded", start.elapsed(), cpu_time() - cpu, bytes.len());
    assert_eq!(heard, FRAMES);

    let simulated = SimulatedRig::start(RigOptions::default())?;
    let mut rig = SerialRig::greet(simulated.port_name())?;
    let (start, cpu) = (Instant::now(), cpu_time());
    let mut latencies = Vec::with_capacity(QUESTIONS);
    for _ in 0..QUESTIONS {
        let asked = Instant::now();
        rig.status()?;
        latencies.push(asked.elapsed());
    }
    latencies.sort();
    let quantile = |q: f64| latencies[((QUESTIONS - 1) as f64 * q) as usize].as_secs_f64() * 1e6;
    println!(
        "asked {QUESTIONS} times across a pseudo-terminal in {:.2} s ({:.2} s of CPU): latency median {:.0} us, 90 % {:.0} us, 99 % {:.0} us, 99.9 % {:.0} us, largest {:.0} us",
        start.elapsed().as_secs_f64(),
        (cpu_time() - cpu).as_secs_f64(),
        quantile(0.5),
        quantile(0.9),
        quantile(0.99),
        quantile(0.999),
        quantile(1.0),
    );
    Ok(())
}

fn report(what: &str, wall: Duration, cpu: Duration, bytes: usize) {
    let wall_s = wall.as_secs_f64();
    println!(
        "{what} {FRAMES} records of a tracker in {wall_s:.3} s ({:.3} s of CPU): {:.2} million frames/s, {:.1} MB/s",
        cpu.as_secs_f64(),
        f64::from(FRAMES) / wall_s / 1e6,
        bytes as f64 / wall_s / 1e6
    );
}

/// What this process has used so far, from the system's own count of hundredths of a second; 0 where it does not tell.
fn cpu_time() -> Duration {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    let ticks = |index: usize| fields.get(index).and_then(|field| field.parse::<u64>().ok()).unwrap_or(0);
    Duration::from_millis(10 * (ticks(11) + ticks(12)))
}
