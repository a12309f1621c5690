//! Rules of access to the page: only the page served here commands the finger.

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
