//! `veiloc serve` with a settings file and variables, as an operator starts it.

use super::common;

use std::path::Path;

use common::folder;

/// Keys and values of printed settings, without their origins.
fn values(printed: &str) -> Vec<&str> {
    printed.lines().map(|line| line.split(" # ").next().unwrap_or_default()).collect()
}

/// The example file has the expected values, and its printed form can be read again.
#[test]
fn example_file_round_trips() {
    let folder = folder();
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/veiloc.example.toml");
    folder.write("veiloc.toml", std::fs::read(example).expect("the example"));
    let printed = folder.run("serve --config veiloc.toml --print-config").succeeded();
    for line in [
        "maps = \"/var/lib/veiloc/maps\" # veiloc.toml, line 6\n",
        "listen = [\"0.0.0.0:8443\"] # veiloc.toml, line ",
        "admin-listen = \"127.0.0.1:9100\" # ",
        "drain-delay = 5.0 # ",
        "queue = 32 # default\n",
        "# threads is not given: one per core\n",
    ] {
        assert!(printed.stdout.contains(line), "{line}\n{printed}");
    }
    folder.write("again.toml", &printed.stdout);
    let again = folder.run("serve --config again.toml --print-config").succeeded();
    assert_eq!(values(&again.stdout), values(&printed.stdout));

    let mut command = folder.command("serve --queue 9 --print-config");
    command.envs([("VEILOC_CONFIG", "veiloc.toml"), ("VEILOC_QUEUE", "8"), ("VEILOC_GRACE", "7")]);
    let output = command.output().expect("the binary runs");
    let text = String::from_utf8(output.stdout).expect("text");
    assert!(
        text.contains("queue = 9 # --queue\n") && text.contains("grace = 7.0 # VEILOC_GRACE\n"),
        "{text}"
    );
}

#[test]
fn settings_errors_name_line_before_any_file_is_opened() {
    let folder = folder();
    for (text, flags, code, parts) in [
        ("maps = \".\"\nquue = 3", "", 1, &["veiloc.toml, line 2", "\"quue\"", "serve --help"][..]),
        ("queue = \"3\"", "--maps .", 1, &["veiloc.toml, line 1", "a whole number"]),
        ("listen = [\"localhost\"]", "--maps .", 1, &["veiloc.toml, line 1", "unix:PATH"]),
        ("cors-origin = [\"*\"]", "--maps .", 1, &["veiloc.toml, line 1", "every page"]),
        ("socket-mode = \"999\"", "--maps .", 1, &["veiloc.toml, line 1", "octal"]),
        ("queue = 3", "", 2, &["--map"]),
        ("maps = \".\"\ncert = \"c.pem\"", "", 2, &["--key"]),
        ("maps = \".\"\ntokens = \"t\"", "--allow-anonymous", 2, &["cannot be used with"]),
        ("maps = \".\"", "--client-ca ca.pem", 2, &["--cert"]),
        ("maps = \".\"\ntokens = \"none\"", "", 1, &["none"]),
        ("maps = \".\"\npage-folder = \"p\"", "", 2, &["--page"]),
        ("maps = \".\"\npage-folder = \"no-page\"", "--page", 1, &["no-page"]),
    ] {
        folder.write("veiloc.toml", text);
        let run = folder.run(&format!("serve --listen 127.0.0.1:0 --config veiloc.toml {flags}"));
        assert_eq!(run.code, Some(code), "{text}: {run}");
        for part in parts {
            assert!(run.stderr.contains(part), "{part}: {run}");
        }
    }
    let run = folder.run("serve --config none.toml");
    assert!(run.code == Some(1) && run.stderr.contains("none.toml"), "{run}");
}

/// A login in the address of a worker or of a collector, or a key in that of a store, is never printed or logged.
#[test]
fn secrets_of_addresses_are_never_printed() {
    let folder = folder();
    std::fs::create_dir(folder.path("objects")).expect("a folder");
    let worker = "http://me:sEcReT@127.0.0.1:1";
    let file =
        |more: &str| format!("workers = [\"{worker}\"]\npublished = [\"town\"]\ncache = \"cache\"\n{more}");
    folder.write("gateway.toml", file("store = \"objects\"\n"));
    let printed = folder.run("serve --config gateway.toml --print-config").succeeded();
    let masked = "workers = [\"http://me:***@127.0.0.1:1\"] # gateway.toml, line 1; write the secret in place of ***\n";
    assert!(printed.stdout.contains(masked), "{printed}");
    // It can be read again. A worker is not asked with a login: it gets a token.
    folder.write("again.toml", &printed.stdout);
    let again = folder.run("serve --config again.toml --print-config").succeeded();
    assert_eq!(values(&again.stdout), values(&printed.stdout));
    let refused = folder.run("serve --config again.toml");
    assert!(refused.code == Some(1) && refused.stderr.contains("--worker-token"), "{refused}");

    folder.write("key.toml", file("store = \"s3://key:sEcReT@bucket/maps\"\n"));
    folder.write("wrong.toml", file("store = \"objects\"\nqueue = \"many\"\n"));
    folder.write("torn.toml", format!("workers = [\"{worker}\n"));
    let mut of_variables = folder.command("serve --print-config --store objects --published town");
    let mut help = folder.command("serve --help");
    for command in [&mut of_variables, &mut help] {
        command.env("VEILOC_WORKERS", worker);
    }
    let mut message =
        vec![of_variables.output().expect("the binary runs"), help.output().expect("the binary runs")];
    for line in [
        "serve --config gateway.toml --log trace",
        "serve --config gateway.toml --log trace --log-json",
        "serve --config key.toml",
        "serve --config key.toml --print-config",
        "serve --config wrong.toml",
        "serve --config torn.toml",
        "serve --store s3://key:sEcReT@bucket/maps --cache cache",
        "serve --maps . --otlp http://me:sEcReT@host --print-config",
        "map fetch s3://key:sEcReT@bucket/maps town --out out",
        "map fetch s3://key:sEcReT@bu^cket:x/maps town --out out",
    ] {
        message.push(folder.command(line).output().expect("the binary runs"));
    }
    for output in message {
        let text =
            [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).into_owned()).concat();
        assert!(!text.is_empty() && !text.contains("sEcReT"), "{text}");
    }
}

/// A gateway says at its start what is missing; it needs no command line.
#[test]
fn gateway_starts_from_a_file_or_from_variables_alone() {
    let folder = folder();
    std::fs::create_dir(folder.path("objects")).expect("a folder");
    folder.write(
        "gateway.toml",
        "workers = [\"http://127.0.0.1:1\"]\npublished = [\"town\"]\nstore = \"objects\"\ncache = \"cache\"\n",
    );
    let started = folder.run("serve --config gateway.toml");
    assert!(started.code == Some(1) && started.stderr.contains("nothing is there"), "{started}");

    let mut command = folder.command("serve --store objects --cache cache");
    command.envs([("VEILOC_WORKERS", "http://127.0.0.1:1"), ("VEILOC_PUBLISHED", "town")]);
    let output = command.output().expect("the binary runs");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(stderr.contains("nothing is there"), "{stderr}");

    for (flags, missing) in [
        ("--store objects --workers http://127.0.0.1:1", "--published"),
        ("--published town --workers http://127.0.0.1:1", "--store"),
        ("--store objects --published town", "--workers"),
    ] {
        let run = folder.run(&format!("serve {flags}"));
        assert!(run.code == Some(2) && run.stderr.contains(missing), "{flags}: {run}");
    }
}
