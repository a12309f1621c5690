//! Services of a finger's ROS 2 node: tare, self-test, and its settings as parameters.
//!
//! A request to the finger waits for the reply, so a thread of its own carries the calls out.

use std::sync::mpsc::{Receiver, Sender, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::{SystemTime, UNIX_EPOCH};

use taxel::wire::message::Info;
use taxel_client::self_test::{findings, named};
use taxel_client::{Client, LinkError, ReconnectingClient, Settings, fields};
use taxel_files::point_method;

use super::finger::lock;
use super::peer::Call;
use super::ros::services::{
    Described, Names, Service, Value, Wishes, describe_response, get_response, list_response,
    request, set_atomically_response, set_response, trigger_response, types_response,
};
use crate::finger::in_16_bits;

/// Calls that wait. Those beyond get no reply.
const QUEUE: usize = 32;
/// Scans averaged by a tare, or measured by a self-test.
const SCANS: u16 = 1000;

const RATE: &str = "rate_hz";
const FILTER: &str = "filter_hz";
const FIELDS: &str = "fields";
const POINT_METHOD: &str = "point_method";

/// Call of a service of the named node.
pub struct Waiting {
    pub node: Arc<str>,
    pub service: Service,
    pub call: Call,
}

/// Thread that carries out the calls of one port's fingers. It ends after all senders are dropped.
pub struct Services {
    pub calls: SyncSender<Waiting>,
    connected: Arc<Mutex<Option<Arc<str>>>>,
}

impl Services {
    /// Starts the thread. It sends the finger's new state to `changed` after each change.
    pub fn start(finger: Arc<ReconnectingClient>, changed: Sender<Info>) -> anyhow::Result<Self> {
        let (calls, waiting) = sync_channel(QUEUE);
        let connected = Arc::new(Mutex::default());
        let worker = Worker { finger, connected: Arc::clone(&connected), changed };
        std::thread::Builder::new()
            .name("taxel-services".to_owned())
            .spawn(move || worker.run(waiting))?;
        Ok(Self { calls, connected })
    }

    /// Names the node of the finger that is connected.
    pub fn connected(&self, node: Arc<str>) {
        *lock(&self.connected) = Some(node);
    }
}

struct Worker {
    finger: Arc<ReconnectingClient>,
    connected: Arc<Mutex<Option<Arc<str>>>>,
    changed: Sender<Info>,
}

impl Worker {
    fn run(&self, waiting: Receiver<Waiting>) {
        for Waiting { node, service, call } in waiting {
            let reply = self.answer(&node, service, &call.payload());
            // A caller whose request is malformed or who is gone gets no reply.
            if let Some(reply) = reply {
                let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
                call.reply(&reply, now);
            }
        }
    }

    fn answer(&self, node: &Arc<str>, service: Service, payload: &[u8]) -> Option<Vec<u8>> {
        let client = self.client(node);
        let all = || client.as_ref().ok().and_then(|client| parameters(client).ok());
        Some(match service {
            Service::Tare => trigger_response(&client.and_then(|client| tare(&client))),
            Service::SelfTest => trigger_response(&client.and_then(|client| self_test(&client))),
            Service::List => list_response(&all()?),
            Service::Get => get_response(&all()?, &request::<Names>(payload)?.names),
            Service::Types => types_response(&all()?, &request::<Names>(payload)?.names),
            Service::Describe => describe_response(&all()?, &request::<Names>(payload)?.names),
            Service::Set => {
                let wishes = request::<Wishes>(payload)?.parameters.into_iter();
                let outcomes: Vec<_> = wishes
                    .map(|wish| {
                        let value = wish.value.try_into().ok();
                        self.set(&client, vec![(wish.name, value)])
                    })
                    .collect();
                set_response(&outcomes)
            }
            Service::SetAtomically => {
                let wishes = request::<Wishes>(payload)?.parameters.into_iter();
                let wishes = wishes.map(|wish| (wish.name, wish.value.try_into().ok())).collect();
                set_atomically_response(&self.set(&client, wishes))
            }
        })
    }

    fn client(&self, node: &Arc<str>) -> Result<Arc<Client>, String> {
        let there = lock(&self.connected).as_ref() == Some(node);
        let client = self.finger.client().filter(|_| there);
        client.ok_or_else(|| format!("{node}: not connected"))
    }

    /// Changes settings, all or none.
    fn set(
        &self,
        client: &Result<Arc<Client>, String>,
        wishes: Vec<(String, Option<Value>)>,
    ) -> Result<(), String> {
        let client = client.as_ref().map_err(Clone::clone)?;
        let orders = wishes.into_iter().map(|(name, value)| order(&name, value));
        let orders = orders.collect::<Result<Vec<_>, _>>()?;
        let (before, _) = Settings::of(client).map_err(text)?;
        let done = orders.iter().try_for_each(|order| order(client));
        if done.is_err() {
            // A failure is told by the first error.
            let _ = before.restore(client);
        }
        let info = self.finger.remember(client).map_err(text)?;
        // After the bridge's end nobody listens.
        let _ = self.changed.send(info);
        done.map_err(text)
    }
}

fn text(error: LinkError) -> String {
    error.to_string()
}

fn tare(client: &Client) -> Result<String, String> {
    let bias = client.take_bias(SCANS).map_err(text)?;
    Ok(if bias.in_contact {
        "bias taken, while something seemed to touch the finger".to_owned()
    } else {
        format!("bias taken over {SCANS} scans")
    })
}

fn self_test(client: &Client) -> Result<String, String> {
    let test = client.self_test(SCANS).map_err(text)?;
    let wrong = findings(&test);
    if wrong.is_empty() {
        Ok(format!("all {} channels are sound", named(&test).len()))
    } else {
        Err(wrong.join("; "))
    }
}

/// Lists the settings of a finger.
fn parameters(client: &Client) -> Result<Vec<Described>, LinkError> {
    let info = client.info()?;
    let scans = i64::from(info.identity.scan_hz);
    let rate = i64::from(info.rate_millihertz.div_ceil(1000));
    let described = |name, description: &str, range, value| Described {
        name,
        description: description.to_owned(),
        range,
        value,
    };
    Ok(vec![
        described(
            RATE,
            "Frames a second; the finger uses the nearest possible rate",
            Some([1, scans.max(1)]),
            Value::Integer(rate),
        ),
        described(
            FILTER,
            "Low-pass on forces and contact points: frequency of -3 dB in Hz, 0 for none",
            Some([0, scans / 4]),
            Value::Integer(info.filter_hz.into()),
        ),
        described(
            FIELDS,
            "Fields that frames carry, with commas between; the wrench needs force,point,torsion",
            None,
            Value::Text(fields::list(info.fields)),
        ),
        described(
            POINT_METHOD,
            "Method of the contact point: centroid, argmin or model",
            None,
            Value::Text(point_method::name(info.point_method).to_owned()),
        ),
    ])
}

type Order = Box<dyn Fn(&Client) -> Result<(), LinkError>>;

/// Checks a wish before anything is changed, and returns the change.
fn order(name: &str, value: Option<Value>) -> Result<Order, String> {
    Ok(match (name, value) {
        (RATE, Some(Value::Integer(hz))) => {
            let hz = in_16_bits(hz);
            Box::new(move |client| client.set_rate(hz).map(drop))
        }
        (FILTER, Some(Value::Integer(hz))) => {
            let hz = in_16_bits(hz);
            Box::new(move |client| client.set_filter(hz))
        }
        (FIELDS, Some(Value::Text(list))) => {
            let chosen = fields::parse(&list).map_err(|error| format!("{name}: {error}"))?;
            Box::new(move |client| client.set_fields(chosen))
        }
        (POINT_METHOD, Some(Value::Text(method))) => {
            let method = point_method::parse(&method).ok_or_else(|| {
                format!("{name}: `{method}` is unknown; choose centroid, argmin or model")
            })?;
            Box::new(move |client| client.set_point_method(method))
        }
        (RATE | FILTER, _) => return Err(format!("{name}: expected an integer, in Hz")),
        (FIELDS | POINT_METHOD, _) => return Err(format!("{name}: expected a string")),
        _ => {
            return Err(format!(
                "unknown parameter `{name}`; choose {RATE}, {FILTER}, {FIELDS} or {POINT_METHOD}"
            ));
        }
    })
}
