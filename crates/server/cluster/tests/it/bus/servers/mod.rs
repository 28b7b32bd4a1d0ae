//! Real NATS servers on loopback, killed when dropped.

use std::net::{TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use veiloc_cluster::bus::NatsOptions;

pub(crate) struct Servers {
    folder: tempfile::TempDir,
    ports: Vec<[u16; 2]>,
    running: Vec<Child>,
}

impl Servers {
    /// Starts a cluster of `count` servers with this message limit.
    pub(crate) fn start(count: usize, max_payload: usize) -> Self {
        // A free port may be taken before its server binds it.
        (0..20).find_map(|_| Self::try_start(count, max_payload)).expect("free ports")
    }

    fn try_start(count: usize, max_payload: usize) -> Option<Self> {
        let folder = tempfile::tempdir().expect("temporary folder");
        std::fs::write(folder.path().join("nats.conf"), format!("max_payload: {max_payload}\n"))
            .expect("written");
        // All ports are held at once, so that they differ.
        let held: Vec<[TcpListener; 2]> =
            (0..count).map(|_| [0, 0].map(|_| TcpListener::bind("127.0.0.1:0").expect("a port"))).collect();
        let port = |listener: &TcpListener| listener.local_addr().expect("bound").port();
        let ports: Vec<[u16; 2]> = held.iter().map(|[a, b]| [port(a), port(b)]).collect();
        drop(held);
        let mut servers = Self { folder, ports, running: Vec::new() };
        servers.running = (0..count).map(|i| servers.spawn(i)).collect();
        (0..count).all(|i| servers.listens(i)).then_some(servers)
    }

    fn spawn(&self, i: usize) -> Child {
        let [port, route] = self.ports[i];
        let routes: Vec<String> =
            self.ports.iter().map(|[_, r]| format!("nats-route://127.0.0.1:{r}")).collect();
        let mut command = Command::new("nats-server");
        command.arg("--config").arg(self.folder.path().join("nats.conf"));
        command.args(["--addr", "127.0.0.1", "--port", &port.to_string(), "--name", &format!("server-{i}")]);
        if self.ports.len() > 1 {
            command.args(["--cluster_name", "test", "--cluster", &format!("nats://127.0.0.1:{route}")]);
            command.args(["--routes", &routes.join(",")]);
        }
        command.stdout(Stdio::null()).stderr(Stdio::null());
        command.spawn().expect("nats-server runs (Debian: apt-get install nats-server)")
    }

    /// Waits until the server listens; false if it exited instead.
    fn listens(&mut self, i: usize) -> bool {
        for _ in 0..2400 {
            if self.running[i].try_wait().expect("a child").is_some() {
                return false;
            }
            if TcpStream::connect(("127.0.0.1", self.ports[i][0])).is_ok() {
                return true;
            }
            std::thread::sleep(Duration::from_millis(50));
        }
        panic!("server {i} never listened");
    }

    pub(crate) fn options(&self) -> NatsOptions {
        let servers = self.ports.iter().map(|[port, _]| format!("nats://127.0.0.1:{port}")).collect();
        NatsOptions { servers, name: "test".to_owned(), ..NatsOptions::default() }
    }

    /// Kills the server as `kill -9` does.
    pub(crate) fn kill(&mut self, i: usize) {
        self.running[i].kill().expect("it runs");
        self.running[i].wait().expect("it ends");
    }

    pub(crate) fn restart(&mut self, i: usize) {
        self.running[i] = self.spawn(i);
        assert!(self.listens(i), "its ports are still free");
    }
}

impl Drop for Servers {
    fn drop(&mut self) {
        for server in &mut self.running {
            let _ = server.kill();
            let _ = server.wait();
        }
    }
}
