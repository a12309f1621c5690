//! Rules of access to the page: only the page served here commands the finger, and beyond this
//! machine only who knows the token.

use std::net::IpAddr;
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

/// Headers of every answer. The page loads and contacts nothing but this server, and no other page
/// may frame it: a frame's visitor could be led to click on its buttons.
const POLICY: [(header::HeaderName, &str); 4] = [
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; \
         connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    ),
    (header::X_FRAME_OPTIONS, "DENY"),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::REFERRER_POLICY, "no-referrer"),
];

/// Adds the policy's headers to an answer.
pub(super) async fn with_policy(mut answer: Response) -> Response {
    for (name, value) in POLICY {
        answer.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    answer
}

/// Rejects requests for other host names. With DNS rebinding a foreign name could lead to this
/// machine. The browser would then let the foreign page command the finger.
pub(super) async fn only_by_own_name(
    State(name): State<Arc<str>>,
    request: Request,
    next: Next,
) -> Response {
    let called = request.headers().get(header::HOST).and_then(|value| value.to_str().ok());
    if is_own(called.unwrap_or_default(), &name) {
        return next.run(request).await;
    }
    let mend = "this page is served by its IP address and as localhost; for another name, give it to --listen";
    (StatusCode::FORBIDDEN, mend).into_response()
}

/// Whether `called` is an IP address, `localhost` or `name`. DNS rebinding needs a name, so that
/// any IP address is safe.
fn is_own(called: &str, name: &str) -> bool {
    let called = host(called);
    called.parse::<IpAddr>().is_ok()
        || ["localhost", name].iter().any(|own| called.eq_ignore_ascii_case(own))
}

/// Extracts the host of `HOST:PORT`, `[HOST]:PORT` or `HOST`.
pub(super) fn host(address: &str) -> &str {
    let end = address.rfind(':').filter(|colon| !address.ends_with(']') && *colon > 0);
    address[..end.unwrap_or(address.len())].trim_matches(['[', ']'])
}

/// Secret of one server, which its address carries as `?token=…`. The page then has it as a cookie.
pub(super) struct Token {
    secret: String,
    /// Name of the cookie: browsers share cookies between the ports of a machine.
    cookie: String,
}

impl Token {
    /// Draws a token of 128 bits for the server at `port`.
    pub(super) fn draw(port: u16) -> std::io::Result<Self> {
        let mut bytes = [0; 16];
        getrandom::fill(&mut bytes).map_err(std::io::Error::other)?;
        let secret = format!("{:032x}", u128::from_be_bytes(bytes));
        Ok(Self { secret, cookie: format!("taxel-{port}") })
    }

    /// Returns the end of the address that opens the page.
    pub(super) fn query(&self) -> String {
        format!("?token={}", self.secret)
    }

    /// Whether one of the `pairs` NAME=VALUE is `name` with the secret. The time taken does not
    /// tell how much of a guess is right.
    fn is_among<'p>(&self, mut pairs: impl Iterator<Item = &'p str>, name: &str) -> bool {
        let right = |value: &str| {
            let differ = |(a, b): (u8, u8)| a ^ b;
            value.len() == self.secret.len()
                && value.bytes().zip(self.secret.bytes()).map(differ).fold(0, |all, d| all | d) == 0
        };
        pairs.any(|pair| pair.trim().split_once('=').is_some_and(|(n, v)| n == name && right(v)))
    }
}

/// Rejects requests without the token; answers one that has it in its address with the cookie.
pub(super) async fn only_with_token(
    State(token): State<Arc<Token>>,
    request: Request,
    next: Next,
) -> Response {
    let query = request.uri().query().unwrap_or_default();
    if token.is_among(query.split('&'), "token") {
        let cookie =
            format!("{}={}; Path=/; HttpOnly; SameSite=Strict", token.cookie, token.secret);
        let mut answer = next.run(request).await;
        if let Ok(cookie) = HeaderValue::from_str(&cookie) {
            answer.headers_mut().append(header::SET_COOKIE, cookie);
        }
        return answer;
    }
    let cookies = request.headers().get_all(header::COOKIE).iter();
    let cookies = cookies.filter_map(|value| value.to_str().ok()).flat_map(|text| text.split(';'));
    if token.is_among(cookies, &token.cookie) {
        return next.run(request).await;
    }
    let mend = "open the whole address that the command printed, with its token";
    (StatusCode::FORBIDDEN, mend).into_response()
}

/// Whether a request comes from the page served here, or from no browser.
pub(super) fn same_origin(headers: &HeaderMap) -> bool {
    let text = |name| headers.get(name).and_then(|value| value.to_str().ok());
    match text(header::ORIGIN) {
        // The client is no browser.
        None => true,
        Some(origin) => {
            let host = origin.split_once("://").map(|(_, host)| host);
            host.is_some() && host == text(header::HOST)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_own_host_names_are_accepted() {
        let name = host("robot.local:8173");
        for own in ["127.0.0.1:8173", "192.168.1.20", "[::1]:8173", "[fe80::1]", "localhost:8173"] {
            assert!(is_own(own, name), "{own}");
        }
        assert!(is_own("Robot.Local:8173", name));
        for other in ["", ":8173", "evil.example:8173", "127.0.0.1.evil.example", "localhost.evil"]
        {
            assert!(!is_own(other, name), "{other}");
        }
    }
}
