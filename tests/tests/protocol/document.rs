//! Writes the protocol document: the words from their own source, the examples from their own types.

use std::fmt::Write;

use quote::ToTokens;
use rigel_protocol::{
    Answer, Bracket, Command, Fault, Format, Halt, Hello, LARGEST_FRAME, LARGEST_PAYLOAD, Orientation,
    Output, Record, Reply, Request, Restart, SCHEMA, State, Status, TrackerState, TrackerStatus, Tracking,
    VERSION, encode,
};
use rigel_simulated::rig::RigOptions;
use syn::{Attribute, Expr, Fields, Item, Lit, Meta};

/// What renews the document.
pub const COMMAND: &str = "cargo run -p rigel-tests --example protocol";
/// The document, from the workspace's folder.
pub const FILE: &str = "docs/protocol.md";

const WORDS: &str = include_str!("../../../protocol/src/words.rs");

/// The document.
pub fn document() -> String {
    let mut out = String::new();
    let words = syn::parse_file(WORDS).expect("the words compile");
    let introduction = introduction();
    write!(out, "{introduction}\n## The words\n\n{}\n\n", docs(&words.attrs)).expect(STRING);
    for item in &words.items {
        describe(item, &mut out);
    }
    out.push_str(
        "## Examples\n\nEvery command and every reply, as frames.\n\n| message | frame |\n|---|---|\n",
    );
    for request in requests() {
        writeln!(out, "| `{request:?}` | `{}` |", hex(&request)).expect(STRING);
    }
    for answer in answers() {
        writeln!(out, "| `{answer:?}` | `{}` |", hex(&answer)).expect(STRING);
    }
    out
}

const STRING: &str = "a string takes everything";

fn introduction() -> String {
    format!(
        "# How host and rig talk

Generated from `protocol/src/words.rs` by `{COMMAND}`; edit that, not this.

Version {VERSION}, schema `{SCHEMA:08x}`.

## The line

A serial line of 115200 baud, 8 data bits, no parity, 1 stop bit, or USB, which ignores that. Either side may speak at any
time.

A message is written with [postcard](https://postcard.jamesmunns.com/wire-format.html): the fields of a struct in their
order; of an enum the number of the variant, then its fields; `u8` and `bool` as a byte; other whole numbers as varints of
seven bits, the lowest first, a set top bit meaning that more come; signed ones zigzag before that (0, -1, 1, -2 are 0, 1, 2,
3); an `Option` as 0 or 1 and the value; strings and `Vec` as their length and content; arrays as their content alone. A
message has at most {LARGEST_PAYLOAD} bytes.

Behind the message comes its CRC-32 (ISO-HDLC, as in zip and Ethernet: polynomial 04C11DB7 reflected, start and final
inversion FFFFFFFF), the lowest byte first. Both together are stuffed by COBS, so that no byte is zero, and stand between two
zeros: `00`, COBS, `00`. A frame has at most {LARGEST_FRAME} bytes. What is longer, no COBS, of a wrong checksum, no message,
or a message with something behind it, is dropped; the next zero begins anew, so that damage costs the frames that it
touches and no other.

## The conversation

1. The host opens a conversation with `Hello`, which tells its version, its schema and a number drawn for this conversation.
   The rig answers with `Hello`. If version and schema of both are the same, the conversation is open; else each side refuses
   the other, and the host names both versions. Nothing but `Hello` is obeyed before: `Refused(NoHello)`. The schema is a
   fingerprint (FNV-1a) of the table of words without comments and spaces: any change of the words changes it. Of another
   version nothing is understood but the beginning of its `Hello`: sequence number, variant 0, version, schema.
2. The host numbers its requests from 1 in each conversation; 0 follows 65535. It asks one thing at a time, and says a request
   again, with the same number, until an answer with that number comes.
3. The rig executes each number once. The latest number again is answered again: with what was replied, or anew where it is
   only a question (`Status`, `Ping`, `Tracker`). An older number is too late: `Refused(Stale)`.
4. What takes time is answered `Accepted`, and its end is an event: an answer with the same number that is not asked for and
   said once. An event can be lost; everything that it says can be asked for with `Status` (or `Tracker`).
5. After a lost line the host goes on with the next number. A rig that has not restarted goes on, too; a rig that has restarted
   says `Refused(NoHello)`, and must be greeted and homed again.
6. While something moves, the host says something more often than `DeadMan` demands, or the rig halts.

The rig's clock counts microseconds since it was switched on. The host says `Ping`, notes when, and when the `Pong` comes: the
rig's reading lies between.
"
    )
}

/// One item of the table.
fn describe(item: &Item, out: &mut String) {
    match item {
        Item::Const(item) => {
            let value = source(&item.expr);
            write!(out, "### `{}` = {value}\n\n{}\n\n", item.ident, docs(&item.attrs)).expect(STRING);
        }
        Item::Struct(item) => {
            write!(
                out,
                "### {}\n\n{}\n\n| field | type | meaning |\n|---|---|---|\n",
                item.ident,
                docs(&item.attrs)
            )
            .expect(STRING);
            for field in &item.fields {
                let name = field.ident.as_ref().map(ToString::to_string).unwrap_or_default();
                let (ty, docs) = (source(&field.ty), docs(&field.attrs));
                writeln!(out, "| `{name}` | `{ty}` | {docs} |").expect(STRING);
            }
            out.push('\n');
        }
        Item::Enum(item) => {
            write!(
                out,
                "### {}\n\n{}\n\n| number | word | meaning |\n|---|---|---|\n",
                item.ident,
                docs(&item.attrs)
            )
            .expect(STRING);
            for (number, variant) in item.variants.iter().enumerate() {
                writeln!(out, "| {number} | `{}` | {} |", variant.ident, docs(&variant.attrs)).expect(STRING);
                for field in &variant.fields {
                    let name = field.ident.as_ref().map(|name| format!("{name}: ")).unwrap_or_default();
                    let (ty, docs) = (source(&field.ty), docs(&field.attrs));
                    writeln!(out, "| | `{name}{ty}` | {docs} |").expect(STRING);
                }
            }
            out.push('\n');
        }
        _ => {}
    }
}

/// A docstring in one line, without the links of rustdoc.
fn docs(attributes: &[Attribute]) -> String {
    let lines = attributes.iter().filter_map(|attribute| {
        let Meta::NameValue(meta) = &attribute.meta else { return None };
        let Expr::Lit(value) = &meta.value else { return None };
        let Lit::Str(text) = &value.lit else { return None };
        meta.path.is_ident("doc").then(|| text.value())
    });
    let text = lines.map(|line| line.trim().to_string()).collect::<Vec<_>>().join(" ");
    text.replace("[`", "`").replace("`]", "`").replace("crate::", "").replace("  ", "\n\n")
}

fn source(tokens: &impl ToTokens) -> String {
    tokens
        .to_token_stream()
        .to_string()
        .replace(' ', "")
        .replace([',', ';'], ", ")
        .replace("[i32, ", "[i32; ")
}

fn hex(message: &impl serde::Serialize) -> String {
    let mut buffer = [0; LARGEST_FRAME];
    let frame = encode(message, &mut buffer).expect("every word fits");
    frame.iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" ")
}

/// The names of an enum's variants.
#[allow(dead_code, reason = "the test's, not the example's")]
pub fn variants(name: &str) -> Vec<String> {
    let words = syn::parse_file(WORDS).expect("the words compile");
    let found = words.items.into_iter().find_map(|item| match item {
        Item::Enum(item) if item.ident == name => Some(item),
        _ => None,
    });
    let item = found.expect("the enum is in the table");
    // Fields of tuples have no names to tell: a table of them would say nothing.
    assert!(item.variants.iter().all(|v| !matches!(&v.fields, Fields::Unnamed(f) if f.unnamed.len() > 1)));
    item.variants.iter().map(|variant| variant.ident.to_string()).collect()
}

/// A request with every command.
pub fn requests() -> Vec<Request> {
    let bracket = Bracket {
        half_press_ms: 300,
        pulses_us: [250_000, 125_000].into_iter().collect(),
        pause_ms: 500,
        confirm_ms: 0,
    };
    let tracking = Tracking { stations: 1, format: Format::Binary, output: Output::Quaternion };
    let commands = [
        Command::Hello { version: VERSION, schema: SCHEMA, conversation: 0x1234_5678 },
        Command::Home,
        Command::MoveTo { pan_mdeg: 90_000, tilt_mdeg: -45_000 },
        Command::Stop,
        Command::Status,
        Command::Ping,
        Command::Trigger(bracket),
        Command::Track(tracking),
        Command::Tracker,
        Command::DeadMan { silence_ms: 5_000 },
    ];
    (1..).zip(commands).map(|(sequence, command)| Request { sequence, command }).collect()
}

/// An answer with every reply.
pub fn answers() -> Vec<Answer> {
    let limits = RigOptions::default().limits;
    let board = "an example".try_into().expect("a short name");
    let (pan_mdeg, tilt_mdeg) = (90_000, -45_000);
    let replies = [
        Reply::Hello(Hello { version: VERSION, schema: SCHEMA, board, limits, restart: Restart::Power }),
        Reply::Accepted { duration_ms: 2_300 },
        Reply::Refused(Fault::TiltOutside { asked_mdeg: 95_000, min_mdeg: -10_000, max_mdeg: 90_000 }),
        Reply::Status(Status {
            state: State::Still,
            pan_mdeg,
            tilt_mdeg,
            halt: None,
            lost_steps: [0, 0],
            exposed: 2,
            confirmed: 0,
            bad_frames: 0,
        }),
        Reply::Pong { at_us: 12_345_678 },
        Reply::Arrived { pan_mdeg, tilt_mdeg },
        Reply::Stopped { pan_mdeg, tilt_mdeg },
        Reply::Halted { halt: Halt::SilentHost, pan_mdeg, tilt_mdeg },
        Reply::Exposed { index: 0, at_us: 12_345_678, confirmed: false },
        Reply::Triggered { exposed: 2, confirmed: 0 },
        Reply::Tracker(TrackerStatus {
            state: TrackerState::Running,
            forwarded: 600,
            rejected: 1,
            skipped_bytes: 20,
            overrun: 0,
            restarts: 0,
        }),
        Reply::Record(Record {
            count: 600,
            at_us: 12_345_678,
            station: 1,
            status: b' ',
            position_um: [300_000, -20_000, 150_000],
            orientation: Orientation::Quaternion([1_000_000, 0, 0, 0]),
        }),
        Reply::Log { text: "the tracker answers again".try_into().expect("a short text") },
    ];
    (1..).zip(replies).map(|(sequence, reply)| Answer { sequence, reply }).collect()
}
