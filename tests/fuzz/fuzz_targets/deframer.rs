//! Both directions of the link, and the instrument's answer to every request.
#![no_main]

use libfuzzer_sys::fuzz_target;
use taxel::instrument::Instrument;
use taxel::store::{RamFlash, Store};
use taxel::units::FullScale;
use taxel::wire::deframer::Deframer;
use taxel::wire::message::{Identity, Message, Request};
use taxel::wire::pack;

fuzz_target!(|bytes: &[u8]| {
    let mut instrument = Instrument::new(Identity {
        board: Default::default(),
        serial: Default::default(),
        build: Default::default(),
        scan_hz: 4000,
        full_scale: FullScale::BITS_12,
        tick_hz: 1,
    });
    let mut store = Store::new(RamFlash::new(vec![0; RamFlash::SIZE]));
    let mut requests = Deframer::<448>::default();
    let mut messages = Deframer::<448>::default();
    for byte in bytes {
        let _: Option<Result<Message, _>> = messages.push(*byte);
        if let Some(Ok(request)) = requests.push::<Request>(*byte)
            && let Some(answer) = instrument.handle(&request, &mut store)
        {
            pack(&answer, &mut [0; 448]).expect("every answer fits a packet");
        }
    }
    // The CRC rejects most inputs, so the messages are also fed directly.
    if let Ok(request) = postcard_request(bytes)
        && let Some(answer) = instrument.handle(&request, &mut store)
    {
        pack(&answer, &mut [0; 448]).expect("every answer fits a packet");
    }
});

fn postcard_request(bytes: &[u8]) -> Result<Request, taxel::wire::WireError> {
    let mut packet = [0; 448];
    let packed = pack(&Raw(bytes.get(..400).unwrap_or(bytes)), &mut packet)?.len();
    taxel::wire::unpack(&mut packet[..packed - 1])
}

/// Bytes packed unchanged.
struct Raw<'a>(&'a [u8]);

impl serde::Serialize for Raw<'_> {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        use serde::ser::SerializeTuple;
        let mut tuple = serializer.serialize_tuple(self.0.len())?;
        for byte in self.0 {
            tuple.serialize_element(byte)?;
        }
        tuple.end()
    }
}
