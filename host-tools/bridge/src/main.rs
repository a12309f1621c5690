//! Zenoh behind a pipe: `taxel bridge` starts this program and writes [`Order`]s to its standard input, until
//! it closes it. Nothing in here knows what a finger is, and nothing in `taxel` what Zenoh is.

mod order;

use std::error::Error;
use std::io::{BufReader, Write};
use std::process::ExitCode;

use order::Order;
use zenoh::qos::CongestionControl;
use zenoh::{Config, Wait};

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // `taxel bridge` makes one line of its own out of it.
            let _ = writeln!(std::io::stderr(), "{error}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), Box<dyn Error + Send + Sync>> {
    let config = std::env::args().nth(1);
    let config = config.ok_or("taxel-bridge CONFIG: it is `taxel bridge` that calls it")?;
    let session = zenoh::open(Config::from_json5(&config)?).wait()?;
    writeln!(std::io::stdout(), "ready")?;
    let mut pipe = BufReader::with_capacity(1 << 16, std::io::stdin().lock());
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
        }
    }
    // Before the session, so that everybody hears that they are gone.
    drop((tokens, publishers));
    session.close().wait()
}
