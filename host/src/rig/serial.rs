//! Serial ports: the only room that knows serialport.

use std::path::{Path, PathBuf};
use std::time::Duration;

use serialport::{ClearBuffer, SerialPortType, UsbPortInfo};

use super::place::{Ends, Place};
use crate::{Error, Result};

/// Ignored by USB, right for the others.
pub(super) const BAUD: u32 = 115_200;
/// How long a read waits: also how long a closed line takes to be let go.
const READ_TIME: Duration = Duration::from_millis(20);

/// A serial port of this computer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Port {
    /// Its name: `/dev/ttyACM0`, `COM3`.
    pub name: String,
    /// The USB device behind it, if there is one.
    pub usb: Option<Usb>,
}

/// How a USB device is known wherever it is plugged in.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Usb {
    /// Who made it.
    pub vendor: u16,
    /// What it is.
    pub product: u16,
    /// Which one of its kind.
    pub serial_number: Option<String>,
    /// What it calls itself.
    pub name: String,
}

impl std::fmt::Display for Usb {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "USB {:04x}:{:04x}", self.vendor, self.product)?;
        if let Some(serial) = &self.serial_number {
            write!(f, " {serial}")?;
        }
        if self.name.is_empty() { Ok(()) } else { write!(f, " ({})", self.name) }
    }
}

/// The serial ports of this computer, by name.
///
/// # Errors
/// [`Error::Device`] when the operating system does not tell.
pub fn ports() -> Result<Vec<Port>> {
    let found = serialport::available_ports().map_err(|e| Error::Device {
        device: "serial ports".into(),
        what: format!("they cannot be listed: {e}"),
        remedy: "name the port yourself".into(),
    })?;
    let mut ports: Vec<Port> = found
        .into_iter()
        .map(|port| Port {
            name: port.port_name,
            usb: match port.port_type {
                SerialPortType::UsbPort(info) => Some(usb(info)),
                _ => None,
            },
        })
        .collect();
    ports.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(ports)
}

fn usb(info: UsbPortInfo) -> Usb {
    let parts = [info.manufacturer, info.product].into_iter().flatten().collect::<Vec<_>>();
    Usb { vendor: info.vid, product: info.pid, serial_number: info.serial_number, name: parts.join(" ") }
}

/// Tells under which names a port may have come back.
type Candidates = Box<dyn FnMut() -> Vec<String> + Send>;

/// A serial port, found again after it was unplugged: a USB device by its vendor, product and serial number, whatever its new
/// name; any other port by its name.
pub struct SerialPlace {
    name: String,
    /// Known once the port was opened.
    usb: Option<Usb>,
    opened: bool,
    candidates: Option<Candidates>,
}

impl SerialPlace {
    /// The port of that name.
    pub fn new(name: &str) -> Self {
        Self { name: name.into(), usb: None, opened: false, candidates: None }
    }

    /// The port of that name; once lost, it is looked for under the names that `candidates` tells.
    pub fn among(name: &str, candidates: impl FnMut() -> Vec<String> + Send + 'static) -> Self {
        Self { candidates: Some(Box::new(candidates)), ..Self::new(name) }
    }

    /// The names under which the port may be found now.
    fn names(&mut self) -> std::result::Result<Vec<String>, String> {
        if !self.opened {
            return Ok(vec![self.name.clone()]);
        }
        if let Some(candidates) = &mut self.candidates {
            return Ok(candidates());
        }
        let Some(usb) = &self.usb else { return Ok(vec![self.name.clone()]) };
        let ports = ports().map_err(|e| e.to_string())?;
        returned(usb, &self.name, &ports)
    }
}

/// The port behind which a USB device has come back. One without a serial number is only taken where there is no doubt.
fn returned(usb: &Usb, old_name: &str, ports: &[Port]) -> std::result::Result<Vec<String>, String> {
    let same = |port: &&Port| port.usb.as_ref().is_some_and(|found| is_same(usb, found));
    let names: Vec<String> = ports.iter().filter(same).map(|port| port.name.clone()).collect();
    if names.len() > 1 && usb.serial_number.is_none() && !names.iter().any(|name| name == old_name) {
        return Err(format!("it could be any of {}", names.join(", ")));
    }
    match names.iter().find(|name| *name == old_name) {
        Some(name) => Ok(vec![name.clone()]),
        None => Ok(names),
    }
}

fn is_same(known: &Usb, found: &Usb) -> bool {
    [known.vendor, known.product] == [found.vendor, found.product]
        && known.serial_number == found.serial_number
}

impl Place for SerialPlace {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn open(&mut self) -> std::result::Result<Ends, String> {
        let mut why = String::from("it is not there");
        for name in self.names()? {
            match open(&name) {
                Ok(ends) => {
                    self.usb = identity(&name).or(self.usb.take());
                    self.name = name;
                    self.opened = true;
                    return Ok(ends);
                }
                Err(error) => why = error.to_string(),
            }
        }
        Err(why)
    }
}

fn open(name: &str) -> serialport::Result<Ends> {
    let mut reader = serialport::new(name, BAUD).timeout(READ_TIME).open()?;
    // A board may wait for this line before it talks; a pseudo-terminal does not have it.
    let _ = reader.write_data_terminal_ready(true);
    // What was said before is of no interest; where it cannot be cleared, the framing copes.
    let _ = reader.clear(ClearBuffer::All);
    let writer = reader.try_clone()?;
    Ok(Ends { reader: Box::new(reader), writer: Box::new(writer) })
}

/// The USB device behind a port, which may be named by a link (`/dev/serial/by-id/...`).
fn identity(name: &str) -> Option<Usb> {
    let real = |name: &str| std::fs::canonicalize(name).unwrap_or_else(|_| PathBuf::from(name));
    let port = ports().ok()?.into_iter().find(|port| Path::new(&port.name) == real(name))?;
    port.usb
}

#[cfg(test)]
mod tests {
    use super::*;

    fn usb(serial_number: Option<&str>) -> Usb {
        Usb { vendor: 0x1209, product: 1, serial_number: serial_number.map(Into::into), name: "rig".into() }
    }

    fn port(name: &str, usb: Option<Usb>) -> Port {
        Port { name: name.into(), usb }
    }

    #[test]
    fn a_usb_device_is_found_under_another_name() {
        let mine = usb(Some("42"));
        let ports = [
            port("ttyACM0", Some(usb(Some("41")))),
            port("ttyACM2", Some(Usb { name: "renamed".into(), ..usb(Some("42")) })),
            port("ttyS0", None),
        ];
        assert_eq!(returned(&mine, "ttyACM0", &ports).unwrap(), ["ttyACM2"]);
        assert!(returned(&mine, "ttyACM0", &ports[..1]).unwrap().is_empty(), "another of its kind is not it");
    }

    #[test]
    fn a_usb_device_without_serial_number_is_not_guessed() {
        let ports = [port("ttyACM1", Some(usb(None))), port("ttyACM2", Some(usb(None)))];
        assert_eq!(returned(&usb(None), "ttyACM0", &ports[1..]).unwrap(), ["ttyACM2"]);
        assert_eq!(returned(&usb(None), "ttyACM1", &ports).unwrap(), ["ttyACM1"]);
        let why = returned(&usb(None), "ttyACM0", &ports).unwrap_err();
        assert!(why.contains("ttyACM1, ttyACM2"), "{why}");
    }

    #[test]
    fn an_identity_tells_what_a_person_looks_for() {
        assert_eq!(usb(Some("42")).to_string(), "USB 1209:0001 42 (rig)");
        assert_eq!(Usb { name: String::new(), ..usb(None) }.to_string(), "USB 1209:0001");
    }
}
