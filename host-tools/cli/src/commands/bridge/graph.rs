//! Names, keys, liveliness tokens and attachments in the format of rmw_zenoh. This is the
//! middleware of ROS 2 systems on Zenoh. Source of every format: its design document, sections
//! "Topic and Service name mapping", "Graph Cache" and "Publishers".

use std::time::Duration;

use xxhash_rust::xxh3::xxh3_128;

use super::ros::Type;

/// Placeholder of an empty part of a liveliness token.
const NONE: &str = "%";

/// Quality of service: a history of ten. Volatile and keep last are the default.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Qos {
    /// Default of ROS 2.
    Reliable,
    BestEffort,
}

impl Qos {
    fn token(self) -> &'static str {
        match self {
            Self::Reliable => "::,10:,:,:,,",
            Self::BestEffort => "2::,10:,:,:,,",
        }
    }
}

/// Context shared by all entities of this program in the ROS graph.
pub struct Context {
    pub domain: u32,
    /// Zenoh session id, in hexadecimal.
    pub session: String,
    pub namespace: Namespace,
    /// Quality of service of publishers.
    pub qos: Qos,
}

/// Absolute ROS name, such as `/taxel`; empty for `/`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Namespace(String);

impl std::str::FromStr for Namespace {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let bare = text.strip_prefix('/').unwrap_or(text);
        if bare.is_empty() {
            return Ok(Self(String::new()));
        }
        match bare.split('/').find(|part| name(part) != *part) {
            None => Ok(Self(format!("/{bare}"))),
            Some(part) => Err(format!(
                "`{part}` is no ROS name; write letters, digits and single underscores, as in /hand/left"
            )),
        }
    }
}

impl Namespace {
    /// Returns the absolute name of a topic in this namespace.
    pub fn topic(&self, name: &str) -> String {
        format!("{}/{name}", self.0)
    }
}

/// Publisher's entry in the ROS graph.
pub struct Publisher {
    /// Zenoh key of the publisher's samples.
    pub key: String,
    pub token: String,
    gid: [u8; 16],
}

/// Entry of a node's service in the ROS graph.
pub struct Server {
    /// Zenoh key of the service's requests.
    pub key: String,
    pub token: String,
}

/// Converts a serial number to a valid ROS name.
pub fn name(serial: &str) -> String {
    let mut name = String::new();
    for c in serial.chars() {
        let c = if c.is_ascii_alphanumeric() { c } else { '_' };
        // ROS reserves two underscores in a row.
        if c != '_' || !name.ends_with('_') {
            name.push(c);
        }
    }
    if !name.starts_with(|c: char| c.is_ascii_alphabetic()) {
        name.insert_str(0, if name.starts_with('_') { "finger" } else { "finger_" });
    }
    name
}

impl Context {
    /// Returns the liveliness token of a node.
    pub fn node(&self, id: u32, name: &str) -> String {
        self.token(id, id, "NN", name)
    }

    /// Creates the entry of a node's publisher.
    pub fn publisher(&self, node: (u32, &str), id: u32, topic: &str, kind: &Type) -> Publisher {
        let (key, token) = self.entity(node, id, ("MP", self.qos), topic, kind);
        let gid = xxh3_128(token.as_bytes()).to_le_bytes();
        Publisher { key, token, gid }
    }

    /// Creates the entry of a node's service.
    pub fn server(&self, node: (u32, &str), id: u32, service: &str, kind: &Type) -> Server {
        let (key, token) = self.entity(node, id, ("SS", Qos::Reliable), service, kind);
        Server { key, token }
    }

    /// Returns key and liveliness token of a topic or service.
    fn entity(
        &self,
        (node_id, node): (u32, &str),
        id: u32,
        (entity, qos): (&str, Qos),
        topic: &str,
        Type { name, hash }: &Type,
    ) -> (String, String) {
        let entity = self.token(node_id, id, entity, node);
        let token = format!("{entity}/{}/{name}/{hash}/{}", mangled(topic), qos.token());
        let key = format!("{}/{}/{name}/{hash}", self.domain, topic.trim_start_matches('/'));
        (key, token)
    }

    fn token(&self, node: u32, id: u32, kind: &str, name: &str) -> String {
        let Self { domain, session, namespace, .. } = self;
        let namespace = mangled(&namespace.0);
        format!("@ros2_lv/{domain}/{session}/{node}/{id}/{kind}/{NONE}/{namespace}/{name}")
    }
}

impl Publisher {
    /// Builds a sample's attachment: sample number, time of publication and publisher id.
    pub fn attachment(&self, number: u64, at: Duration) -> [u8; 33] {
        let mut bytes = [0; 33];
        let (numbers, gid) = bytes.split_at_mut(16);
        numbers[..8].copy_from_slice(&number.to_le_bytes());
        numbers[8..].copy_from_slice(&(at.as_nanos() as u64).to_le_bytes());
        gid[0] = self.gid.len() as u8;
        gid[1..].copy_from_slice(&self.gid);
        bytes
    }
}

/// Builds the attachment of a reply: that of its request, with the time of the reply. `None` if the
/// request has none of rmw_zenoh.
#[cfg(any(feature = "zenoh", test))]
pub fn reply_attachment(request: &[u8], at: Duration) -> Option<[u8; 33]> {
    let mut bytes: [u8; 33] = request.try_into().ok()?;
    bytes[8..16].copy_from_slice(&(at.as_nanos() as u64).to_le_bytes());
    Some(bytes)
}

fn mangled(name: &str) -> String {
    if name.is_empty() { NONE.to_owned() } else { name.replace('/', "%") }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STRING: Type = Type {
        name: "std_msgs::msg::dds_::String_",
        hash: "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    };

    fn context(domain: u32, namespace: &str) -> Context {
        let session = "8b20917502ee955ac4476e0266340d5c".to_owned();
        Context { domain, session, namespace: namespace.parse().unwrap(), qos: Qos::Reliable }
    }

    /// Examples of rmw_zenoh's design document, except for the depth of the history.
    #[test]
    fn keys_and_tokens_match_rmw_zenoh_document() {
        let talker = context(2, "/").publisher((0, "talker"), 10, "/chatter", &STRING);
        assert_eq!(
            talker.token.replace(",10:", ",7:"),
            "@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter/\
             std_msgs::msg::dds_::String_/\
             RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18/::,7:,:,:,,"
        );
        assert_eq!(
            context(2, "").node(0, "listener"),
            "@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/0/NN/%/%/listener"
        );
        let robot = context(0, "/robot1");
        let topic = robot.namespace.topic("chatter");
        let talker = robot.publisher((0, "talker"), 10, &topic, &STRING);
        assert_eq!(
            talker.key,
            "0/robot1/chatter/std_msgs::msg::dds_::String_/\
             RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
        );
        assert!(talker.token.contains("/MP/%/%robot1/talker/%robot1%chatter/"), "{}", talker.token);
        let quick = Context { qos: Qos::BestEffort, ..context(2, "/") };
        let talker = quick.publisher((0, "talker"), 10, "/chatter", &STRING);
        assert!(talker.token.ends_with("/2::,10:,:,:,,"), "{}", talker.token);
        let sum = Type {
            name: "example_interfaces::srv::dds_::AddTwoInts_",
            hash: "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a",
        };
        let server = quick.server((0, "add_two_ints_server"), 10, "/add_two_ints", &sum);
        let (name, hash) = (sum.name, sum.hash);
        assert_eq!(server.key, format!("2/add_two_ints/{name}/{hash}"));
        let tail =
            format!("/0/10/SS/%/%/add_two_ints_server/%add_two_ints/{name}/{hash}/::,10:,:,:,,");
        assert!(server.token.ends_with(&tail), "{}", server.token);
    }

    #[test]
    fn reply_repeats_number_and_client_of_its_request() {
        let request: [u8; 33] = std::array::from_fn(|i| i as u8);
        let reply = reply_attachment(&request, Duration::new(1, 2)).unwrap();
        assert_eq!((&reply[..8], &reply[16..]), (&request[..8], &request[16..]));
        assert_eq!(reply[8..16], [2, 202, 154, 59, 0, 0, 0, 0]);
        assert_eq!(reply_attachment(&request[1..], Duration::ZERO), None);
    }

    #[test]
    fn attachment_holds_number_time_and_publisher() {
        let publisher = context(0, "/").publisher((0, "talker"), 1, "/chatter", &STRING);
        let bytes = publisher.attachment(7, Duration::new(1, 2));
        assert_eq!(bytes[..16], [7, 0, 0, 0, 0, 0, 0, 0, 2, 202, 154, 59, 0, 0, 0, 0]);
        assert_eq!(bytes[16], 16);
        let other = context(0, "/").publisher((0, "talker"), 2, "/chatter", &STRING);
        assert_ne!(bytes, other.attachment(7, Duration::new(1, 2)));
    }

    #[test]
    fn serial_numbers_become_valid_ros_names() {
        for (serial, expected) in [
            ("F-0042", "F_0042"),
            ("press", "press"),
            ("0042", "finger_0042"),
            ("a--b  c", "a_b_c"),
            ("_x", "finger_x"),
            ("", "finger_"),
        ] {
            assert_eq!(name(serial), expected);
        }
        assert!("/hand/left".parse::<Namespace>().is_ok());
        assert!("/hand//left".parse::<Namespace>().unwrap_err().contains("no ROS name"));
        assert!("hand-left".parse::<Namespace>().is_err());
    }
}
