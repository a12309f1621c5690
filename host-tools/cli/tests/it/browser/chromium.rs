//! Headless Chromium, driven over its DevTools protocol.

use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use crate::common::until;
use serde_json::{Value, json};
use tungstenite::stream::MaybeTlsStream;
use tungstenite::{Message, WebSocket, connect};

/// Page in a browser of its own.
pub struct Browser {
    process: Child,
    socket: WebSocket<MaybeTlsStream<TcpStream>>,
    session: String,
    id: u64,
    _profile: tempfile::TempDir,
}

impl Browser {
    /// Opens `url` in a window of this size, in pixels.
    pub fn open(url: &str, width: u32, height: u32) -> Self {
        let mut browser = Self::blank(width, height);
        browser.show(url);
        browser
    }

    /// Opens an empty window of this size.
    pub fn blank(width: u32, height: u32) -> Self {
        let profile = tempfile::tempdir().unwrap();
        let mut process = Command::new("chromium")
            .args(["--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"])
            .args(["--remote-debugging-port=0", "--no-first-run", "--disable-extensions"])
            // A foreign name that leads here, for the tests of access.
            .arg("--host-resolver-rules=MAP rebound.test 127.0.0.1")
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg("about:blank")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("chromium is needed for the tests of the page: install your system's package");
        let mut said = BufReader::new(process.stderr.take().unwrap()).lines();
        let address = said
            .by_ref()
            .map_while(Result::ok)
            .find_map(|line| line.strip_prefix("DevTools listening on ").map(str::to_owned));
        // Discards further output, so that the pipe never fills.
        std::thread::spawn(move || said.for_each(drop));
        let (socket, _) = connect(address.expect("chromium has no DevTools")).unwrap();
        let session = String::new();
        let mut browser = Self { process, socket, session, id: 0, _profile: profile };
        let target = browser.ask("Target.createTarget", json!({ "url": "about:blank" }));
        let attach = json!({ "targetId": target["targetId"], "flatten": true });
        let attached = browser.ask("Target.attachToTarget", attach);
        browser.session = attached["sessionId"].as_str().unwrap().to_owned();
        browser.resize(width, height);
        browser.ask("Page.enable", json!({}));
        browser
    }

    /// Goes to an address.
    pub fn go(&mut self, url: &str) {
        self.ask("Page.navigate", json!({ "url": url }));
    }

    /// Opens the page and waits until it shows something.
    pub fn show(&mut self, url: &str) {
        self.go(url);
        self.wait_for("window.taxel?.latest?.length > 0 || window.taxel?.trouble");
    }

    /// Leaves the page.
    pub fn leave(&mut self) {
        self.go("about:blank");
        self.wait_for("location.href === 'about:blank' && document.readyState === 'complete'");
    }

    pub fn resize(&mut self, width: u32, height: u32) {
        let size = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600 });
        self.ask("Emulation.setDeviceMetricsOverride", size);
    }

    pub fn dark(&mut self, dark: bool) {
        let value = if dark { "dark" } else { "light" };
        let features = json!([{ "name": "prefers-color-scheme", "value": value }]);
        self.ask("Emulation.setEmulatedMedia", json!({ "features": features }));
    }

    /// Sends a DevTools command and waits for its answer.
    fn ask(&mut self, method: &str, params: Value) -> Value {
        self.id += 1;
        let mut command = json!({ "id": self.id, "method": method, "params": params });
        if !self.session.is_empty() {
            command["sessionId"] = json!(self.session);
        }
        self.socket.send(Message::text(command.to_string())).unwrap();
        loop {
            let Message::Text(text) = self.socket.read().unwrap() else { continue };
            let mut answer: Value = serde_json::from_str(text.as_str()).unwrap();
            if answer["id"] == self.id {
                assert_eq!(answer["error"], Value::Null, "{method}");
                return answer["result"].take();
            }
        }
    }

    /// Processor seconds of all the browser's processes.
    pub fn cpu_seconds(&mut self) -> f64 {
        // The command goes to the browser, not to the page.
        let session = std::mem::take(&mut self.session);
        let info = self.ask("SystemInfo.getProcessInfo", json!({}));
        self.session = session;
        let processes = info["processInfo"].as_array().unwrap();
        processes.iter().map(|process| process["cpuTime"].as_f64().unwrap()).sum()
    }

    /// Evaluates an expression in the page.
    pub fn value(&mut self, expression: &str) -> Value {
        let params =
            json!({ "expression": expression, "returnByValue": true, "awaitPromise": true });
        let mut answer = self.ask("Runtime.evaluate", params);
        assert_eq!(answer["exceptionDetails"], Value::Null, "{expression}");
        answer["result"]["value"].take()
    }

    /// Waits until an expression is true in the page.
    pub fn wait_for(&mut self, expression: &str) {
        until(expression, || self.value(&format!("Boolean({expression})")) == true);
    }

    /// Waits until the page has drawn its plots so often.
    pub fn redrawn(&mut self, times: u32) {
        self.value("void (window.before = taxel.draws)");
        self.wait_for(&format!("taxel.draws >= before + {times}"));
    }

    /// Sends an event of the mouse: `mouseMoved`, `mousePressed` or `mouseReleased`.
    pub fn mouse(&mut self, kind: &str, x: f64, y: f64, pressed: bool, clicks: u32) {
        let button = if pressed { "left" } else { "none" };
        let event = json!({ "type": kind, "x": x, "y": y, "button": button,
            "buttons": u8::from(pressed && kind != "mouseReleased"), "clickCount": clicks });
        self.ask("Input.dispatchMouseEvent", event);
    }

    /// Presses a key, as a user does.
    pub fn key(&mut self, key: &str) {
        for kind in ["keyDown", "keyUp"] {
            let text = if key.len() == 1 && kind == "keyDown" { key } else { "" };
            let code = match key {
                "Tab" => 9,
                "Enter" => 13,
                " " => 32,
                "ArrowRight" => 39,
                _ => 0,
            };
            let text = if key == "Enter" && kind == "keyDown" { "\r" } else { text };
            let event =
                json!({ "type": kind, "key": key, "text": text, "windowsVirtualKeyCode": code });
            self.ask("Input.dispatchKeyEvent", event);
        }
    }

    /// Lists the addresses of the frames within the page.
    pub fn frames(&mut self) -> Vec<String> {
        let tree = self.ask("Page.getFrameTree", json!({}));
        let frames = tree["frameTree"]["childFrames"].as_array().cloned().unwrap_or_default();
        let url = |frame: &Value| frame["frame"]["url"].as_str().unwrap_or_default().to_owned();
        frames.iter().map(url).collect()
    }

    pub fn text(&mut self, id: &str) -> String {
        let text = self.value(&format!("document.getElementById('{id}').innerText"));
        text.as_str().unwrap_or_default().to_owned()
    }

    /// Takes a picture of the whole page; saved if `TAXEL_SCREENSHOTS` names a folder.
    pub fn picture(&mut self, name: &str) {
        let height =
            self.value("Math.ceil(document.documentElement.getBoundingClientRect().height)");
        let width = self.value("innerWidth");
        let clip = json!({ "x": 0, "y": 0, "width": width, "height": height, "scale": 1 });
        let params = json!({ "format": "png", "captureBeyondViewport": true, "clip": clip });
        let data = self.ask("Page.captureScreenshot", params);
        let data = data["data"].as_str().unwrap();
        assert!(data.len() > 10_000, "an empty picture");
        if let Some(folder) = std::env::var_os("TAXEL_SCREENSHOTS") {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(folder);
            std::fs::write(path.join(format!("{name}.png")), decode(data)).unwrap();
        }
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Decodes Base64, the protocol's format of pictures.
fn decode(text: &str) -> Vec<u8> {
    use base64::Engine as _;
    base64::engine::general_purpose::STANDARD.decode(text).unwrap()
}
