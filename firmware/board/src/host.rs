//! The line to the host: frames in, frames out.

use embassy_futures::select::{Either, select};
use embassy_stm32::usart::{BufferedUartRx, BufferedUartTx};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use embedded_io_async::{Read, Write};
use rigel_protocol::{Answer, Decoder, LARGEST_FRAME, encode, frame};

use crate::motion::{HEARD, Heard};

/// What is to be said. An answer that finds no room is lost; the host asks again.
pub static ANSWERS: Channel<CriticalSectionRawMutex, Answer, 8> = Channel::new();
/// The tracker's records, which wait while there are answers: half a second of them.
pub static RECORDS: Channel<CriticalSectionRawMutex, Answer, 32> = Channel::new();

/// Hears requests.
#[embassy_executor::task]
pub async fn hear(mut line: BufferedUartRx<'static>) -> ! {
    let mut decoder = Decoder::new();
    let mut bytes = [0; 32];
    loop {
        // An error is noise on the line: the frame's checksum tells.
        let count = line.read(&mut bytes).await.unwrap_or(0);
        for &byte in &bytes[..count] {
            if let Some(frame) = decoder.push(byte) {
                HEARD.send(frame.and_then(frame::decode).map_or(Heard::Noise, Heard::Request)).await;
            }
        }
    }
}

/// Says answers.
#[embassy_executor::task]
pub async fn say(mut line: BufferedUartTx<'static>) -> ! {
    let mut buffer = [0; LARGEST_FRAME];
    loop {
        let (Either::First(answer) | Either::Second(answer)) =
            select(ANSWERS.receive(), RECORDS.receive()).await;
        if let Ok(frame) = encode(&answer, &mut buffer) {
            // There is no error that this line could tell.
            let _ = line.write_all(frame).await;
        }
    }
}
