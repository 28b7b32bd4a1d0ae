//! A collector of traces.

use std::io::{Read, Write};
use std::net::TcpListener;
use std::sync::{Arc, Mutex};

use serde_json::Value;

/// A collector that stores its messages: OTLP over HTTP, as far as one client needs it.
pub struct Collector {
    pub address: String,
    messages: Arc<Mutex<Vec<String>>>,
}

impl Collector {
    pub fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = format!("http://{}", listener.local_addr().expect("an address"));
        let messages = Arc::new(Mutex::new(Vec::new()));
        let stored = messages.clone();
        std::thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let stored = stored.clone();
                std::thread::spawn(move || receive(stream, &stored));
            }
        });
        Self { address, messages }
    }

    pub fn text(&self) -> String {
        self.messages.lock().expect("not poisoned").join("\n")
    }

    /// All received spans of the service of this name.
    pub fn spans(&self, service: &str) -> Vec<Value> {
        let messages = self.messages.lock().expect("not poisoned").clone();
        let bodies = messages.iter().map(|m| m.split_once("\r\n\r\n").expect("a head").1.to_owned());
        let documents = bodies.map(|body| serde_json::from_str::<Value>(&body).expect("JSON"));
        documents
            .map(|document| document["resourceSpans"][0].clone())
            .filter(|sent| sent["resource"]["attributes"][0]["value"]["stringValue"] == service)
            .flat_map(|sent| sent["scopeSpans"][0]["spans"].as_array().expect("spans").clone())
            .collect()
    }
}

/// Stores head and body of every request of a connection.
fn receive(mut stream: std::net::TcpStream, stored: &Mutex<Vec<String>>) {
    loop {
        let mut bytes = Vec::new();
        let mut byte = [0];
        while !bytes.ends_with(b"\r\n\r\n") {
            let Ok(1) = stream.read(&mut byte) else { return };
            bytes.push(byte[0]);
        }
        let head = String::from_utf8(bytes).expect("a head");
        let length =
            head.lines().find_map(|l| l.to_lowercase().strip_prefix("content-length: ").map(str::to_owned));
        let mut body = vec![0; length.expect("a length").trim().parse().expect("a number")];
        stream.read_exact(&mut body).expect("a body");
        stored.lock().expect("not poisoned").push(head + &String::from_utf8(body).expect("text"));
        let answer = b"HTTP/1.1 200 OK\r\ncontent-type: application/json\r\ncontent-length: 2\r\n\r\n{}";
        stream.write_all(answer).expect("answered");
    }
}

/// An attribute of a span, as text.
pub fn attribute<'a>(span: &'a Value, key: &str) -> Option<&'a str> {
    let attributes = span["attributes"].as_array()?;
    let value = &attributes.iter().find(|attribute| attribute["key"] == key)?["value"];
    value["stringValue"].as_str().or(value["intValue"].as_str())
}
