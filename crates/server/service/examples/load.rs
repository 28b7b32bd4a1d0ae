//! Load test of a running service: requests per second and percentiles of the response time, by number of
//! connections, as comma-separated values; `study service load` runs it.
//!
//! ```text
//! veiloc serve --map place=place.vmap --rate 1000000 &
//! cargo run --release -p veiloc-service --example load -- 127.0.0.1:8080 place query.vquery 1 4 16 64
//! ```
//!
//! Loopback only, with a fixed number of requests. Each connection sends its next request as soon as the last one is
//! answered. A refused request is counted and not repeated; its connection continues after the `Retry-After` of the
//! service, cut to a tenth of a second, so that a full queue stays full.

#[path = "../tests/it/common/http.rs"]
mod http;

use std::io::Write as _;
use std::net::SocketAddr;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use http::{Request, Response, connect};

/// Requests per row of the table, shared by the connections.
const REQUESTS: usize = 640;
/// Pause after a refusal.
const PAUSE: Duration = Duration::from_millis(100);

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match run(&arguments) {
        Ok(table) => {
            let _ = std::io::stdout().write_all(table.as_bytes());
            ExitCode::SUCCESS
        }
        Err(reason) => {
            let usage = "usage: load ADDRESS MAP QUERY_FILE CONNECTIONS… (token in VEILOC_TOKEN)";
            let _ = writeln!(std::io::stderr(), "{reason}\n{usage}");
            ExitCode::from(2)
        }
    }
}

fn run(arguments: &[String]) -> Result<String, String> {
    let [address, map, file, connections @ ..] = arguments else {
        return Err("too few arguments".to_owned());
    };
    let address: SocketAddr = address.parse().map_err(|e| format!("{address}: {e}"))?;
    if !address.ip().is_loopback() {
        return Err("the load test runs against the local machine only: give a loopback address".to_owned());
    }
    let query = std::fs::read(file).map_err(|e| format!("{file}: {e}"))?;
    let token = std::env::var("VEILOC_TOKEN").unwrap_or_default();
    let request = Request::post(&format!("/v1/maps/{map}/localize"), &query)
        .header("content-type", "application/x-protobuf")
        .token(&token)
        .bytes();
    let mut table =
        "connections,requests,answered,refused (503),other,lost,answers/s,p50 ms,p95 ms,p99 ms,slowest refusal ms\n"
            .to_owned();
    for count in connections {
        let count: usize = count.parse().map_err(|e| format!("{count}: {e}"))?;
        if count == 0 || count > REQUESTS {
            return Err(format!("from 1 to {REQUESTS} connections"));
        }
        table += &row(count, &load(address, &request, count));
    }
    Ok(table)
}

/// Result of one request: its status (`None` if the connection broke) and its duration.
type RequestResult = (Option<u16>, Duration);

struct Load {
    all: Vec<RequestResult>,
    took: Duration,
}

fn load(address: SocketAddr, request: &[u8], connections: usize) -> Load {
    let started = Instant::now();
    let one = || -> Vec<RequestResult> {
        let mut stream = connect(address);
        let send = |_| {
            let started_at = Instant::now();
            let response = stream.write_all(request).ok().and_then(|()| Response::try_read(&mut stream));
            let got = (response.as_ref().map(|r| r.status), started_at.elapsed());
            if response.is_none() {
                stream = connect(address);
            }
            if matches!(got.0, Some(429 | 503)) {
                std::thread::sleep(PAUSE);
            }
            got
        };
        (0..REQUESTS / connections).map(send).collect()
    };
    let all = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..connections).map(|_| scope.spawn(one)).collect();
        threads.into_iter().flat_map(|thread| thread.join().unwrap_or_default()).collect()
    });
    Load { all, took: started.elapsed() }
}

fn row(connections: usize, load: &Load) -> String {
    let times = |wanted: fn(Option<u16>) -> bool| -> Vec<f64> {
        let of = load.all.iter().filter(|(status, _)| wanted(*status));
        let mut times: Vec<f64> = of.map(|(_, time)| time.as_secs_f64() * 1e3).collect();
        times.sort_by(f64::total_cmp);
        times
    };
    let answered = times(|status| status == Some(200));
    let refused = times(|status| status == Some(503));
    let lost = times(|status| status.is_none()).len();
    let at = |share: f64| match answered.len() {
        0 => f64::NAN,
        n => answered[((n - 1) as f64 * share).round() as usize],
    };
    format!(
        "{connections},{},{},{},{},{lost},{:.1},{:.0},{:.0},{:.0},{:.0}\n",
        load.all.len(),
        answered.len(),
        refused.len(),
        load.all.len() - answered.len() - refused.len() - lost,
        answered.len() as f64 / load.took.as_secs_f64(),
        at(0.5),
        at(0.95),
        at(0.99),
        refused.last().copied().unwrap_or(0.0),
    )
}
