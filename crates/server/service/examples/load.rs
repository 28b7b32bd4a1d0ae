//! A load on a running service: requests per second and percentiles of the time to an answer, by number of connections.
//!
//! ```text
//! veiloc serve --map place=place.vmap --rate 1000000 &
//! cargo run --release -p veiloc-service --example load -- 127.0.0.1:8080 place query.vquery 1 4 16 64
//! ```
//!
//! Loopback only, a fixed number of requests, each connection sending its next one as soon as the last is answered. A
//! refused request is not sent again but counted; its connection goes on after a pause of the service's own
//! `Retry-After`, cut to a tenth of a second, so that a full queue is kept full.

#[path = "../tests/it/common/http.rs"]
mod http;

use std::io::Write as _;
use std::net::SocketAddr;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use http::{Request, Response, connect};

/// Requests of a row of the table; more connections share them.
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
        return Err("a load is for one's own machine: give a loopback address".to_owned());
    }
    let query = std::fs::read(file).map_err(|e| format!("{file}: {e}"))?;
    let token = std::env::var("VEILOC_TOKEN").unwrap_or_default();
    let request = Request::post(&format!("/v1/maps/{map}/localize"), &query)
        .header("content-type", "application/x-protobuf")
        .token(&token)
        .bytes();
    let mut table =
        "| connections | requests | answered | refused (503) | other | lost | answers/s | p50 ms | p95 ms | \
                     p99 ms | slowest refusal ms |\n|---|---|---|---|---|---|---|---|---|---|---|\n"
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

/// What one request got: its status (`None` when the connection broke) and the time it took.
type Got = (Option<u16>, Duration);

struct Load {
    all: Vec<Got>,
    took: Duration,
}

fn load(address: SocketAddr, request: &[u8], connections: usize) -> Load {
    let started = Instant::now();
    let one = || -> Vec<Got> {
        let mut stream = connect(address);
        let send = |_| {
            let asked = Instant::now();
            let response = stream.write_all(request).ok().and_then(|()| Response::try_read(&mut stream));
            let got = (response.as_ref().map(|r| r.status), asked.elapsed());
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
        "| {connections} | {} | {} | {} | {} | {lost} | {:.1} | {:.0} | {:.0} | {:.0} | {:.0} |\n",
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
