//! Requests and responses of a finger's services, in CDR: triggers and the parameters of a node.
//!
//! Parameters are those of `rcl_interfaces`, so that `ros2 param` and every ROS 2 program that sets
//! parameters works.

use serde::{Deserialize, Serialize};

use super::{Type, cdr};

/// `std_srvs/srv/Trigger`.
const TRIGGER: Type = Type {
    name: "std_srvs::srv::dds_::Trigger_",
    hash: "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
};
const LIST: Type = Type {
    name: "rcl_interfaces::srv::dds_::ListParameters_",
    hash: "RIHS01_3e6062bfbb27bfb8730d4cef2558221f51a11646d78e7bb30a1e83afac3aad9d",
};
const GET: Type = Type {
    name: "rcl_interfaces::srv::dds_::GetParameters_",
    hash: "RIHS01_bf9803d5c74cf989a5de3e0c2e99444599a627c7ff75f97b8c05b01003675cbc",
};
const TYPES: Type = Type {
    name: "rcl_interfaces::srv::dds_::GetParameterTypes_",
    hash: "RIHS01_da199c878688b3e530bdfe3ca8f74cb9fa0c303101e980a9e8f260e25e1c80ca",
};
const DESCRIBE: Type = Type {
    name: "rcl_interfaces::srv::dds_::DescribeParameters_",
    hash: "RIHS01_845b484d71eb0673dae682f2e3ba3c4851a65a3dcfb97bddd82c5b57e91e4cff",
};
const SET: Type = Type {
    name: "rcl_interfaces::srv::dds_::SetParameters_",
    hash: "RIHS01_56eed9a67e169f9cb6c1f987bc88f868c14a8fc9f743a263bc734c154015d7e0",
};
const SET_ATOMICALLY: Type = Type {
    name: "rcl_interfaces::srv::dds_::SetParametersAtomically_",
    hash: "RIHS01_0e192ef259c07fc3c07a13191d27002222e65e00ccec653ca05e856f79285fcd",
};

/// Services of a finger. ROS 2 tools expect all of those of parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Service {
    Tare,
    SelfTest,
    List,
    Get,
    Types,
    Describe,
    Set,
    SetAtomically,
}

impl Service {
    pub const ALL: [Self; 8] = [
        Self::Tare,
        Self::SelfTest,
        Self::List,
        Self::Get,
        Self::Types,
        Self::Describe,
        Self::Set,
        Self::SetAtomically,
    ];

    /// Name below the node's.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tare => "tare",
            Self::SelfTest => "self_test",
            Self::List => "list_parameters",
            Self::Get => "get_parameters",
            Self::Types => "get_parameter_types",
            Self::Describe => "describe_parameters",
            Self::Set => "set_parameters",
            Self::SetAtomically => "set_parameters_atomically",
        }
    }

    pub fn kind(self) -> &'static Type {
        match self {
            Self::Tare | Self::SelfTest => &TRIGGER,
            Self::List => &LIST,
            Self::Get => &GET,
            Self::Types => &TYPES,
            Self::Describe => &DESCRIBE,
            Self::Set => &SET,
            Self::SetAtomically => &SET_ATOMICALLY,
        }
    }
}

#[derive(Serialize)]
struct TriggerResponse<'m> {
    success: bool,
    message: &'m str,
}

/// Encodes the response of a trigger: what was done, or why not.
pub fn trigger_response(outcome: &Result<String, String>) -> Vec<u8> {
    let (Ok(message) | Err(message)) = outcome;
    cdr(&TriggerResponse { success: outcome.is_ok(), message })
}

/// Request with names of parameters: `GetParameters`, `GetParameterTypes`, `DescribeParameters`.
#[derive(Deserialize)]
pub struct Names {
    pub names: Vec<String>,
}

/// Request with values of parameters: `SetParameters`, `SetParametersAtomically`.
#[derive(Deserialize)]
pub struct Wishes {
    pub parameters: Vec<Parameter>,
}

#[derive(Deserialize)]
pub struct Parameter {
    pub name: String,
    pub value: ParameterValue,
}

/// `rcl_interfaces/msg/ParameterValue`: all kinds of values, of which `kind` names the one meant.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ParameterValue {
    kind: u8,
    truth: bool,
    integer: i64,
    double: f64,
    string: String,
    bytes: Vec<u8>,
    truths: Vec<bool>,
    integers: Vec<i64>,
    doubles: Vec<f64>,
    strings: Vec<String>,
}

/// Value of a parameter, of one of the kinds that a finger has.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    Integer(i64),
    Text(String),
}

const INTEGER: u8 = 2;
const STRING: u8 = 4;

impl Value {
    fn kind(&self) -> u8 {
        match self {
            Self::Integer(_) => INTEGER,
            Self::Text(_) => STRING,
        }
    }
}

impl From<Value> for ParameterValue {
    fn from(value: Value) -> Self {
        let kind = value.kind();
        match value {
            Value::Integer(integer) => Self { kind, integer, ..Self::default() },
            Value::Text(string) => Self { kind, string, ..Self::default() },
        }
    }
}

impl TryFrom<ParameterValue> for Value {
    type Error = ();

    fn try_from(value: ParameterValue) -> Result<Self, ()> {
        match value.kind {
            INTEGER => Ok(Self::Integer(value.integer)),
            STRING => Ok(Self::Text(value.string)),
            _ => Err(()),
        }
    }
}

/// Parameter of a finger with its present value.
pub struct Described {
    pub name: &'static str,
    pub description: String,
    /// Least and greatest value of an integer.
    pub range: Option<[i64; 2]>,
    pub value: Value,
}

#[derive(Serialize)]
struct ParameterDescriptor<'d> {
    name: &'d str,
    kind: u8,
    description: &'d str,
    additional_constraints: &'static str,
    read_only: bool,
    dynamic_typing: bool,
    floating_point_range: Vec<[f64; 3]>,
    integer_range: Vec<IntegerRange>,
}

#[derive(Serialize)]
struct IntegerRange {
    from_value: i64,
    to_value: i64,
    step: u64,
}

#[derive(Serialize)]
struct ListResponse<'d> {
    names: Vec<&'d str>,
    prefixes: Vec<&'d str>,
}

#[derive(Serialize)]
struct SetResult<'r> {
    successful: bool,
    reason: &'r str,
}

/// Encodes the names of all parameters.
pub fn list_response(all: &[Described]) -> Vec<u8> {
    cdr(&ListResponse { names: all.iter().map(|one| one.name).collect(), prefixes: Vec::new() })
}

/// Encodes the values of the named parameters. An unknown one has no kind.
pub fn get_response(all: &[Described], names: &[String]) -> Vec<u8> {
    let value =
        |name: &String| find(all, name).map(|one| one.value.clone().into()).unwrap_or_default();
    cdr(&names.iter().map(value).collect::<Vec<ParameterValue>>())
}

/// Encodes the kinds of the named parameters; 0 for an unknown one.
pub fn types_response(all: &[Described], names: &[String]) -> Vec<u8> {
    let kind = |name: &String| find(all, name).map_or(0, |one| one.value.kind());
    cdr(&names.iter().map(kind).collect::<Vec<u8>>())
}

/// Encodes the descriptions of the named parameters, empty for an unknown one.
pub fn describe_response(all: &[Described], names: &[String]) -> Vec<u8> {
    cdr(&names.iter().map(|name| descriptor(all, name)).collect::<Vec<_>>())
}

fn descriptor<'d>(all: &'d [Described], name: &'d str) -> ParameterDescriptor<'d> {
    let one = find(all, name);
    let range = one.and_then(|one| one.range).map(|[from_value, to_value]| IntegerRange {
        from_value,
        to_value,
        step: 1,
    });
    ParameterDescriptor {
        name,
        kind: one.map_or(0, |one| one.value.kind()),
        description: one.map_or("", |one| &one.description),
        additional_constraints: "",
        read_only: false,
        dynamic_typing: false,
        floating_point_range: Vec::new(),
        integer_range: range.into_iter().collect(),
    }
}

/// Encodes an outcome for each parameter.
pub fn set_response(outcomes: &[Result<(), String>]) -> Vec<u8> {
    cdr(&outcomes.iter().map(set_result).collect::<Vec<_>>())
}

/// Encodes the common outcome of all parameters.
pub fn set_atomically_response(outcome: &Result<(), String>) -> Vec<u8> {
    cdr(&set_result(outcome))
}

fn set_result(outcome: &Result<(), String>) -> SetResult<'_> {
    let reason = outcome.as_ref().err().map_or("", String::as_str);
    SetResult { successful: outcome.is_ok(), reason }
}

fn find<'d>(all: &'d [Described], name: &str) -> Option<&'d Described> {
    all.iter().find(|one| one.name == name)
}

/// Decodes a request after the four bytes of its header. `None` if it is malformed.
pub fn request<T: for<'de> Deserialize<'de>>(payload: &[u8]) -> Option<T> {
    // The second byte marks the order of bytes, the others are options that change nothing here.
    let (header, body) = payload.split_at_checked(4)?;
    let (request, _) = match header[1] {
        1 => cdr_encoding::from_bytes::<T, byteorder::LittleEndian>(body).ok()?,
        0 => cdr_encoding::from_bytes::<T, byteorder::BigEndian>(body).ok()?,
        _ => return None,
    };
    Some(request)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn malformed_request_is_refused() {
        assert!(request::<Names>(&[]).is_none());
        assert!(request::<Names>(&[0, 1, 0, 0]).is_none());
        // One name of 4 GB, then a list of as many names.
        assert!(request::<Names>(&[0, 1, 0, 0, 1, 0, 0, 0, 255, 255, 255, 255]).is_none());
        assert!(request::<Names>(&[0, 1, 0, 0, 255, 255, 255, 255]).is_none());
        assert!(request::<Wishes>(&[0, 7, 0, 0, 0, 0, 0, 0]).is_none());
    }

    #[test]
    fn request_is_read_in_both_byte_orders() {
        let little = [0, 1, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0, b'a', 0];
        let big = [0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 2, b'a', 0];
        for bytes in [little, big] {
            assert_eq!(request::<Names>(&bytes).unwrap().names, ["a"]);
        }
    }
}
