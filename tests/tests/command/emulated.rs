//! The firmware's image in QEMU: its lines, and every edge on its outputs.
//!
//! QEMU does not model the chip's GPIO. It reports every write to it instead (`-d unimp`), in order: this is what
//! the pins are read from, so that the image runs the very code that drives them.

use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime};

/// The image with the feature `emulator`, and QEMU; `None`, after saying what is missing, where one of them is not there.
/// With `CI` set that is a failure.
pub fn image() -> Option<PathBuf> {
    let image =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../firmware/board/target/rigel-firmware-emulator.elf");
    let qemu = Command::new("qemu-system-arm").arg("--version").output();
    let missing = if !image.exists() {
        "the firmware's image: tools/firmware build"
    } else if qemu.is_err() {
        "qemu-system-arm"
    } else {
        return Some(image);
    };
    assert!(std::env::var_os("CI").is_none(), "missing: {missing}");
    eprintln!("skipped: missing {missing}");
    None
}

/// The shutter's contact has closed.
#[derive(Debug, Clone, Copy)]
pub struct Photograph {
    /// Where the rig stood, see [`Edges::position`].
    pub at: [i64; 2],
    /// When this was heard.
    pub time: SystemTime,
}

/// What the outputs have done since the start. Pairs are pan and tilt.
#[derive(Debug, Clone, Default)]
pub struct Edges {
    /// Steps forwards less steps backwards.
    pub position: [i64; 2],
    /// Steps in any direction.
    pub steps: [u64; 2],
    /// Every photograph that was begun.
    pub photographs: Vec<Photograph>,
    /// How many photographs have ended.
    pub ended: usize,
    /// Steps while a photograph was taken.
    pub blurred: u64,
    /// Photographs without half-press.
    pub unfocused: u64,
    /// Whether the motors have current.
    pub enabled: bool,
    /// What the ports show.
    levels: [u16; 2],
}

const PORT_B: usize = 0;
const PORT_C: usize = 1;
const STEP: [u16; 2] = [1 << 0, 1 << 2];
const DIRECTION: [u16; 2] = [1 << 1, 1 << 3];
const DISABLE: u16 = 1 << 4;
const HALF_PRESS: u16 = 1 << 12;
const SHUTTER: u16 = 1 << 13;

impl Edges {
    /// Takes a line of QEMU's report.
    fn hear(&mut self, line: &str) {
        let port = match line.split_once(": unimplemented device write (size 4, offset 0x018, value 0x") {
            Some(("GPIOB", _)) => PORT_B,
            Some(("GPIOC", _)) => PORT_C,
            _ => return,
        };
        let digits = line.rsplit("0x").next().unwrap().trim_end_matches(')');
        let value = u32::from_str_radix(digits, 16).unwrap();
        let (set, reset) = (value as u16, (value >> 16) as u16);
        let before = self.levels;
        self.levels[port] = self.levels[port] & !reset | set;
        let rises =
            |port: usize, pin: u16, levels: [u16; 2]| before[port] & pin == 0 && levels[port] & pin != 0;
        for axis in 0..2 {
            if rises(PORT_C, STEP[axis], self.levels) {
                let forwards = self.levels[PORT_C] & DIRECTION[axis] != 0;
                self.position[axis] += if forwards { 1 } else { -1 };
                self.steps[axis] += 1;
                self.blurred += u64::from(self.levels[PORT_B] & SHUTTER != 0);
            }
        }
        if rises(PORT_B, SHUTTER, self.levels) {
            self.photographs.push(Photograph { at: self.position, time: SystemTime::now() });
            self.unfocused += u64::from(self.levels[PORT_B] & HALF_PRESS == 0);
        }
        self.ended += usize::from(before[PORT_B] & !self.levels[PORT_B] & SHUTTER != 0);
        self.enabled = self.levels[PORT_C] & DISABLE == 0;
    }
}

/// The image, running.
pub struct Board {
    qemu: Child,
    folder: tempfile::TempDir,
    /// The port at which a host finds it.
    pub port_name: String,
    edges: Arc<Mutex<Edges>>,
    report: Option<JoinHandle<()>>,
}

impl Board {
    /// Starts the image. The second line's other end is returned beside it: it must always be read, for QEMU halts a board
    /// whose line is full.
    pub fn start(image: &Path) -> (Self, UnixStream) {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name).display().to_string();
        let mut qemu = Command::new("qemu-system-arm")
            .args(["-M", "netduinoplus2", "-display", "none", "-d", "unimp"])
            .args(["-kernel", &image.display().to_string()])
            .args(["-chardev", &format!("pty,id=host,path={}", path("host")), "-serial", "chardev:host"])
            .args(["-chardev", &format!("socket,id=tracker,server=on,wait=on,path={}", path("tracker"))])
            .args(["-serial", "chardev:tracker"])
            .args(["-monitor", &format!("unix:{},server=on,wait=off", path("monitor"))])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let edges = Arc::new(Mutex::new(Edges::default()));
        let report = {
            let (edges, lines) = (edges.clone(), BufReader::new(qemu.stderr.take().unwrap()));
            std::thread::spawn(move || {
                for line in lines.lines().map_while(Result::ok) {
                    edges.lock().unwrap().hear(&line);
                }
            })
        };
        let tracker = until("the tracker's line", || UnixStream::connect(path("tracker")).ok());
        let host = until("the host's line", || std::fs::read_link(path("host")).ok());
        let port_name = host.display().to_string();
        (Self { qemu, folder, port_name, edges, report: Some(report) }, tracker)
    }

    /// What the outputs have done until now.
    pub fn edges(&self) -> MutexGuard<'_, Edges> {
        self.edges.lock().unwrap()
    }

    /// A handle on what the outputs do, for another thread.
    pub fn watch(&self) -> Arc<Mutex<Edges>> {
        self.edges.clone()
    }

    /// Bytes of the board's memory.
    pub fn memory(&self, start: u32, length: u32) -> Vec<u8> {
        let file = self.folder.path().join("memory");
        let mut monitor = UnixStream::connect(self.folder.path().join("monitor")).unwrap();
        // The prompt comes again when a command has been obeyed.
        let prompt = |monitor: &mut UnixStream| {
            let mut heard = Vec::new();
            while !heard.ends_with(b"(qemu) ") {
                let mut byte = [0];
                std::io::Read::read_exact(monitor, &mut byte).unwrap();
                heard.push(byte[0]);
            }
        };
        prompt(&mut monitor);
        writeln!(monitor, "pmemsave {start:#x} {length:#x} \"{}\"", file.display()).unwrap();
        prompt(&mut monitor);
        std::fs::read(file).unwrap()
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        let _ = self.qemu.kill();
        let _ = self.qemu.wait();
        if let Some(report) = self.report.take() {
            let _ = report.join();
        }
    }
}

/// Waits for what takes a moment.
pub fn until<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + Duration::from_secs(30);
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(Instant::now() < deadline, "{what} does not come");
        std::thread::sleep(Duration::from_millis(10));
    }
}
