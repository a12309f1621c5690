//! Control transfers and their requests (USB 2.0, 9.3, 9.4).

use crate::board::Outcome;
use crate::board::time::Tick;

/// Standard and class requests: type and request.
pub const GET_DESCRIPTOR: [u8; 2] = [0x80, 6];
pub const SET_ADDRESS: [u8; 2] = [0x00, 5];
pub const SET_CONFIGURATION: [u8; 2] = [0x00, 9];
pub const SET_LINE_CODING: [u8; 2] = [0x21, 0x20];
pub const GET_LINE_CODING: [u8; 2] = [0xa1, 0x21];
pub const SET_CONTROL_LINE_STATE: [u8; 2] = [0x21, 0x22];
/// Requests to an endpoint; the only feature is ENDPOINT_HALT, 0.
pub const CLEAR_FEATURE: [u8; 2] = [0x02, 1];
pub const SET_FEATURE: [u8; 2] = [0x02, 3];

/// Types of descriptors.
pub const DEVICE: u8 = 1;
pub const CONFIGURATION: u8 = 2;
pub const STRING: u8 = 3;
pub const ENDPOINT: u8 = 5;
pub const QUALIFIER: u8 = 6;
pub const BOS: u8 = 15;

/// Control transfer in progress.
#[derive(Clone, Debug)]
pub struct Control {
    pub setup: [u8; 8],
    pub data: Vec<u8>,
    pub moved: usize,
    pub stage: Stage,
    pub data1: bool,
    pub begun: Tick,
    /// Whether the host expects a stall.
    pub refused: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    Setup,
    Data,
    Status,
}

impl Control {
    pub fn new([kind, request]: [u8; 2], value: u16, index: u16, length: u16) -> Self {
        let [v, i, l] = [value, index, length].map(u16::to_le_bytes);
        let setup = [kind, request, v[0], v[1], i[0], i[1], l[0], l[1]];
        Self {
            setup,
            data: Vec::new(),
            moved: 0,
            stage: Stage::Setup,
            data1: true,
            begun: 0,
            refused: false,
        }
    }

    pub fn sending(request: [u8; 2], value: u16, data: &[u8]) -> Self {
        Self { data: data.to_vec(), ..Self::new(request, value, 0, data.len() as u16) }
    }

    pub fn is_in(&self) -> bool {
        self.setup[0] & 0x80 != 0
    }

    pub fn length(&self) -> usize {
        usize::from(u16::from_le_bytes([self.setup[6], self.setup[7]]))
    }

    pub fn is(&self, request: [u8; 2]) -> bool {
        self.setup[..2] == request
    }
}

pub fn descriptor(kind: u8, number: u8, length: u16) -> Control {
    // Strings are asked for in English; string 0 lists the languages.
    let language = if kind == STRING && number > 0 { 0x0409 } else { 0 };
    Control::new(GET_DESCRIPTOR, u16::from(kind) << 8 | u16::from(number), language, length)
}

/// Numbers of the bulk endpoints in a configuration: to the host, to the device.
pub fn bulk_endpoints(configuration: &[u8]) -> Outcome<[u8; 2]> {
    let (mut found, mut rest) = ([None; 2], configuration);
    while let Some((length, _)) = rest.split_first() {
        let Some((descriptor, after)) = rest.split_at_checked(usize::from(*length).max(2)) else {
            return Err("configuration with wrong descriptor lengths".into());
        };
        if let [_, ENDPOINT, address, 2, ..] = *descriptor {
            found[usize::from(address & 0x80 == 0)] = Some(address & 0xf);
        }
        rest = after;
    }
    match found {
        [Some(data_in), Some(data_out)] => Ok([data_in, data_out]),
        _ => Err("configuration without a bulk endpoint in each direction".into()),
    }
}
