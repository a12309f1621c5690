//! Self-test on a page's order: its result in a sentence, and each channel for the picture.

use serde_json::{Value, json};
use taxel::self_test::SelfTest;
use taxel_client::self_test::{Fault, faults, named};
use taxel_client::{Client, LinkError};

/// Most scans of a self-test.
const SCANS: u16 = 1000;
/// Noisy channels above which the finger, not its wiring, is the reason.
const MOVES: usize = 3;

/// Tests the finger for at most half a second, because other pages' orders wait meanwhile.
pub(super) fn run(client: &Client) -> Result<SelfTest, LinkError> {
    let half = client.info()?.identity.scan_hz / 2;
    client.self_test(half.clamp(1, SCANS))
}

/// Returns the result of a self-test in one sentence; the page draws its channels.
pub(super) fn verdict(test: &SelfTest) -> String {
    let wrong = faults(test);
    let channels = named(test).len();
    let noisy = wrong.iter().filter(|fault| fault.noisy).count();
    match wrong.as_slice() {
        [] => format!("self-test: all {channels} channels are as they should be"),
        [fault] => format!("self-test: {}", fault.text),
        _ if noisy > MOVES => format!(
            "self-test: {noisy} of {channels} channels are noisy: let go of the finger, keep it still and \
             shaded, and test again"
        ),
        faults => format!("self-test: {} faults on {channels} channels", faults.len()),
    }
}

/// Returns each channel's level, noise and fault for the page.
pub(super) fn facts(test: &SelfTest) -> Value {
    let wrong = faults(test);
    let channels = named(test).into_iter().map(|(name, channel)| {
        let of = |fault: &&Fault| fault.channel.as_ref() == Some(&name);
        let fault = wrong.iter().filter(of).max_by_key(|fault| !fault.noisy);
        json!({
            "name": name,
            "mean": channel.mean,
            "noise": channel.noise,
            "noisy": fault.is_some_and(|fault| fault.noisy),
            "fault": fault.map(|fault| &fault.text),
        })
    });
    let others = wrong.iter().filter(|fault| fault.channel.is_none()).map(|fault| &fault.text);
    json!({
        "channels": channels.collect::<Vec<_>>(),
        "others": others.collect::<Vec<_>>(),
        "full_scale": test.full_scale.top().0,
    })
}
