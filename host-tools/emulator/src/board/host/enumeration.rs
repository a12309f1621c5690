//! Enumeration of a new device, as Linux does it.

use super::Host;
use super::control::{
    BOS, CLEAR_FEATURE, CONFIGURATION, Control, DEVICE, GET_DESCRIPTOR, GET_LINE_CODING, QUALIFIER,
    SET_ADDRESS, SET_CONFIGURATION, SET_CONTROL_LINE_STATE, SET_LINE_CODING, STRING,
    bulk_endpoints, descriptor,
};
use crate::board::Outcome;
use crate::board::capture::Kind;
use crate::board::time::{Tick, micros};
use crate::board::usb::Device;

const ADDRESS: u8 = 7;
/// Recovery time of a device after SET_ADDRESS (USB 2.0, 9.2.6.3).
const ADDRESS_RECOVERY: Tick = micros(2_000);

/// 115200 baud, one stop bit, no parity, eight bits.
const LINE_CODING: [u8; 7] = [0x00, 0xc2, 0x01, 0x00, 0, 0, 8];

impl Host {
    /// Queues the first request after a reset.
    pub(super) fn ask_first(&mut self) {
        self.queue.push_back(if self.resets == 1 {
            descriptor(DEVICE, 0, 64)
        } else {
            Control::new(SET_ADDRESS, u16::from(ADDRESS), 0, 0)
        });
    }

    /// Handles the end of a control transfer and queues the next ones.
    pub(super) fn conclude(
        &mut self,
        control: Control,
        now: Tick,
        usb: &mut dyn Device,
    ) -> Outcome {
        let number = if control.is_in() { 0x80 } else { 0 };
        self.note(Kind::Control, number, Some((control.setup, control.begun)), &control.data, now);
        self.occupy(now, 0);
        if control.is(SET_ADDRESS) {
            self.address = ADDRESS;
            self.free = now + self.wait(ADDRESS_RECOVERY);
            self.queue.push_back(descriptor(DEVICE, 0, 18));
        } else if control.is(SET_CONFIGURATION) {
            self.toggles = [false; 2];
            self.queue.push_back(Control::sending(SET_LINE_CODING, 0, &LINE_CODING));
            self.queue.push_back(Control::new(GET_LINE_CODING, 0, 0, 7));
        } else if control.is(CLEAR_FEATURE) {
            // Data restart with DATA0 (USB 2.0, 9.4.5).
            self.toggles[0] = false;
        } else if control.is(GET_LINE_CODING) {
            if control.data != LINE_CODING {
                return Err(format!("the line coding is {:02x?}", control.data));
            }
            self.configured = true;
        } else if control.is(SET_CONTROL_LINE_STATE) {
            // DTR
            self.opened = control.setup[2] & 1 == 1;
        } else if control.is(GET_DESCRIPTOR) {
            return self.learn(&control, now, usb);
        }
        Ok(())
    }

    /// Stores a descriptor and queues the next requests.
    fn learn(&mut self, control: &Control, now: Tick, usb: &mut dyn Device) -> Outcome {
        let [_, _, number, kind, ..] = control.setup;
        let data = &control.data;
        match kind {
            DEVICE if self.address == 0 => self.reset(now, usb),
            DEVICE => {
                let [.., manufacturer, product, serial, configurations] = data[..] else {
                    return Err("truncated device descriptor".into());
                };
                if configurations != 1 {
                    return Err(format!("{configurations} configurations, expected 1"));
                }
                self.descriptors.device.clone_from(data);
                // A full-speed device has no qualifier and answers with a stall.
                self.queue.push_back(Control { refused: true, ..descriptor(QUALIFIER, 0, 10) });
                // From USB 2.01 on a device has a BOS descriptor.
                if data.get(2..4).is_some_and(|bcd| [bcd[1], bcd[0]] > [2, 0]) {
                    self.queue.push_back(descriptor(BOS, 0, 5));
                }
                self.queue.push_back(descriptor(CONFIGURATION, 0, 9));
                self.queue.push_back(descriptor(STRING, 0, 255));
                for string in
                    [manufacturer, product, serial].into_iter().filter(|string| *string > 0)
                {
                    self.queue.push_back(descriptor(STRING, string, 255));
                }
                self.queue.push_back(Control::new(SET_CONFIGURATION, 1, 0, 0));
            }
            CONFIGURATION | BOS if control.length() < 10 => {
                let Some([low, high]) = data.get(2..4) else {
                    return Err(format!(
                        "request {:02x?}: too short an answer {data:02x?}",
                        control.setup
                    ));
                };
                let whole = u16::from_le_bytes([*low, *high]);
                // Goes before the queued requests.
                self.queue.push_front(descriptor(kind, number, whole.max(10)));
            }
            CONFIGURATION => {
                self.descriptors.configuration.clone_from(data);
                self.bulk = Some(bulk_endpoints(data)?);
            }
            STRING if number > 0 => {
                let units: Vec<u16> = data
                    .get(2..)
                    .unwrap_or_default()
                    .as_chunks::<2>()
                    .0
                    .iter()
                    .map(|c| u16::from_le_bytes(*c))
                    .collect();
                self.descriptors.strings.push((number, String::from_utf16_lossy(&units)));
            }
            _ => {}
        }
        Ok(())
    }
}
