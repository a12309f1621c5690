//! Orders as samples and tokens of a Zenoh session.

use zenoh::qos::CongestionControl;
use zenoh::{Config, Wait};

use crate::order::{self, Order};
use crate::{Failure, ready};

/// Opens a session and does what is ordered until the pipe closes.
pub fn run(config: &str) -> Result<(), Failure> {
    let session = zenoh::open(Config::from_json5(config)?).wait()?;
    let mut pipe = ready("")?;
    let mut buffer = Vec::new();
    let (mut tokens, mut publishers) = (Vec::new(), Vec::new());
    while let Some(order) = order::next(&mut pipe, &mut buffer)? {
        match order {
            Order::Token(key) => {
                tokens.push(session.liveliness().declare_token(key.to_owned()).wait()?);
            }
            Order::Publisher(key) => {
                let publisher = session
                    .declare_publisher(key.to_owned())
                    // A reader that does not keep up loses samples, which their numbers tell, and holds up
                    // nobody else.
                    .congestion_control(CongestionControl::Drop);
                publishers.push(publisher.wait()?);
            }
            Order::Put { publisher, attachment, payload } => {
                let publisher = publishers.get(publisher as usize).ok_or("no such publisher")?;
                publisher.put(payload).attachment(attachment).wait()?;
            }
            Order::Channel { .. } | Order::Message { .. } => {
                return Err("Zenoh has no channels".into());
            }
        }
    }
    // Before the session, so that everybody hears that they are gone.
    drop((tokens, publishers));
    session.close().wait()
}
