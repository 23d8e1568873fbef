//! `lumel view`: hands the viewer and the files of one bake to a browser on this machine, or writes both into one page.
//!
//! The server listens on 127.0.0.1 only and gives out what the manifest of the bake lists, by exact name, and nothing else: there is no
//! path to traverse. A request under another host name is refused, so that no web page can reach the files by giving this address a
//! name of its own.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use lumel::{Error, Result};
use percent_encoding::percent_decode_str;
use serde_json::{Map, Value, json};
use tiny_http::{Header, Method, Request, Response, Server};

use super::args::View;
use super::print;
use super::run::Outcome;

/// The viewer, built from `viewer/` and kept there.
const VIEWER: &str = include_str!("../../../viewer/dist/index.html");

/// Where the viewer looks for its bake.
const PLACE: &str = "<script id=\"bake\" type=\"application/json\">null</script>";

/// Ending of a manifest's name.
const MANIFEST: &str = ".lumel.json";

/// Bytes that one page may hold. Browsers keep it in a text of at most half a gigabyte, and base64 adds a third.
const MAX_EMBEDDED: u64 = 300 << 20;

/// A bake in a folder.
struct Bake {
    folder: PathBuf,
    /// Name of the manifest.
    name: String,
    manifest: Value,
    /// Names of the files that belong to it.
    files: BTreeSet<String>,
}

pub(crate) fn run(args: &View) -> Result<Outcome> {
    let bake = Bake::open(&args.path)?;
    match &args.html {
        Some(file) => bake.embed(file)?,
        None => serve(&bake, args)?,
    }
    Ok(Outcome::Done)
}

impl Bake {
    /// `path` is a manifest, or a folder that holds exactly one.
    fn open(path: &Path) -> Result<Self> {
        let io = |source| Error::Io {
            path: path.to_owned(),
            source,
        };
        let manifest = if fs::metadata(path).map_err(io)?.is_dir() {
            let mut found: Vec<PathBuf> = fs::read_dir(path)
                .map_err(io)?
                .filter_map(|entry| Some(entry.ok()?.path()))
                .filter(|path| path.to_string_lossy().ends_with(MANIFEST))
                .collect();
            found.sort();
            match found.as_slice() {
                [one] => one.clone(),
                [] => return Err(invalid(path, "holds no bake (no .lumel.json)")),
                several => {
                    let names: Vec<String> = several
                        .iter()
                        .map(|path| path.display().to_string())
                        .collect();
                    let names = names.join(", ");
                    return Err(invalid(
                        path,
                        &format!("holds several bakes, name one: {names}"),
                    ));
                }
            }
        } else {
            path.to_owned()
        };
        Self::read(&manifest)
    }

    fn read(path: &Path) -> Result<Self> {
        let text = fs::read(path).map_err(|source| Error::Io {
            path: path.to_owned(),
            source,
        })?;
        let manifest: Value = serde_json::from_slice(&text)
            .map_err(|error| invalid(path, &format!("is no manifest: {error}")))?;
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        let name = path
            .file_name()
            .and_then(|name| name.to_str())
            .filter(|name| name.ends_with(MANIFEST))
            .ok_or_else(|| invalid(path, "is no manifest (.lumel.json)"))?
            .to_owned();
        let listed = manifest["files"]
            .as_array()
            .ok_or_else(|| invalid(path, "is no manifest: it lists no files"))?;
        // By now the manifest is anybody's text: only plain names of regular files in its own folder count.
        let files = listed
            .iter()
            .filter_map(Value::as_str)
            .filter(|file| !file.contains(['/', '\\', ':', '\0']) && !file.starts_with('.'))
            .filter(|file| {
                fs::symlink_metadata(folder.join(file)).is_ok_and(|found| found.is_file())
            })
            .map(str::to_owned)
            .chain([name.clone()])
            .collect();
        Ok(Self {
            folder,
            name,
            manifest,
            files,
        })
    }

    /// What the viewer looks at: the level, and the maps, those of the light vector only where no texture holds them as well.
    fn viewed(&self) -> Vec<&str> {
        let level = self.name.replace(MANIFEST, ".glb");
        let pages = self.manifest["pages"].as_array();
        let maps = pages
            .into_iter()
            .flatten()
            .filter_map(|page| page["maps"].as_array());
        let mut wanted = BTreeSet::from([self.name.as_str(), level.as_str()]);
        for maps in maps {
            let has_texture = maps.iter().any(|map| map["plane"] == "ktx2");
            for map in maps {
                let plane = map["plane"].as_str().unwrap_or_default();
                let in_texture = ["Gr", "Gg", "Gb", "phi"].contains(&plane) && has_texture;
                if plane != "preview" && !in_texture {
                    wanted.extend(map["file"].as_str());
                }
            }
        }
        let files = self.files.iter().map(String::as_str);
        files.filter(|file| wanted.contains(file)).collect()
    }

    /// Writes the viewer with the bake inside to `target`.
    fn embed(&self, target: &Path) -> Result<()> {
        let mut files = Map::new();
        let mut size = 0;
        for name in self.viewed() {
            let path = self.folder.join(name);
            let io = |source| Error::Io {
                path: path.clone(),
                source,
            };
            size += fs::metadata(&path).map_err(io)?.len();
            if size > MAX_EMBEDDED {
                return Err(Error::TooLarge {
                    reason: format!(
                        "a page holds at most {} MB, the bake has more; view it without --html",
                        MAX_EMBEDDED >> 20
                    ),
                });
            }
            let bytes = fs::read(&path).map_err(io)?;
            files.insert(name.to_owned(), STANDARD.encode(bytes).into());
        }
        let page = page(&json!({"manifest": self.name, "files": files}))?;
        fs::write(target, page).map_err(|source| Error::Io {
            path: target.to_owned(),
            source,
        })
    }
}

/// The viewer, told where its bake is.
fn page(bake: &Value) -> Result<String> {
    // A name could end the script that holds it.
    let text = bake.to_string().replace('<', "\\u003c");
    let (before, after) = VIEWER.split_once(PLACE).ok_or_else(|| Error::Io {
        path: PathBuf::from("the built-in viewer"),
        source: std::io::ErrorKind::InvalidData.into(),
    })?;
    let [open, close] = [
        "<script id=\"bake\" type=\"application/json\">",
        "</script>",
    ];
    Ok([before, open, &text, close, after].concat())
}

fn serve(bake: &Bake, args: &View) -> Result<()> {
    let address = SocketAddr::from((Ipv4Addr::LOCALHOST, args.port));
    let failed = |source: std::io::Error| Error::Io {
        path: PathBuf::from(format!("http://{address}/")),
        source,
    };
    let server = Server::http(address).map_err(|error| failed(std::io::Error::other(error)))?;
    let Some(address) = server.server_addr().to_ip() else {
        return Err(failed(std::io::ErrorKind::AddrNotAvailable.into()));
    };
    let hosts = ["127.0.0.1", "localhost"].map(|host| format!("{host}:{}", address.port()));
    let page = page(&json!({"manifest": bake.name}))?;
    print::out(&format!("http://{address}/\n"))?;
    if !args.no_open {
        open(&format!("http://{address}/"));
    }
    for request in server.incoming_requests() {
        // A browser that went away is nobody's error.
        let _ = answer(request, bake, &page, &hosts);
    }
    Ok(())
}

fn answer(request: Request, bake: &Bake, page: &str, hosts: &[String; 2]) -> std::io::Result<()> {
    let host = request
        .headers()
        .iter()
        .find(|header| header.field.equiv("Host"))
        .map(|header| header.value.as_str());
    if !host.is_some_and(|host| hosts.iter().any(|known| known == host)) {
        return request.respond(Response::from_string("wrong host").with_status_code(403));
    }
    if ![Method::Get, Method::Head].contains(request.method()) {
        return request.respond(Response::from_string("only GET").with_status_code(405));
    }
    let path = request.url().split(['?', '#']).next().unwrap_or_default();
    if path == "/" {
        let response = Response::from_string(page).with_chunked_threshold(usize::MAX);
        return request.respond(response.with_header(content_type("index.html")));
    }
    let name = path
        .strip_prefix("/files/")
        .and_then(|name| percent_decode_str(name).decode_utf8().ok())
        .filter(|name| bake.files.contains(name.as_ref()));
    let file = name.and_then(|name| {
        let file = File::open(bake.folder.join(name.as_ref())).ok()?;
        Some((content_type(&name), file))
    });
    match file {
        // Whole, with its length in front, so that the browser can make room at once.
        Some((kind, file)) => request.respond(
            Response::from_file(file)
                .with_chunked_threshold(usize::MAX)
                .with_header(kind),
        ),
        None => request.respond(Response::from_string("no such file").with_status_code(404)),
    }
}

fn content_type(name: &str) -> Header {
    let kind = match name.rsplit('.').next() {
        Some("html") => "text/html; charset=utf-8",
        Some("json") => "application/json",
        Some("png") => "image/png",
        Some("glb") => "model/gltf-binary",
        Some("ktx2") => "image/ktx2",
        _ => "application/octet-stream",
    };
    Header::from_bytes("Content-Type", kind).expect("the kinds above are ASCII")
}

/// Asks the desktop to open `url`; where there is none, the address is printed anyway.
fn open(url: &str) {
    let (program, arguments): (&str, &[&str]) = if cfg!(target_os = "macos") {
        ("open", &[])
    } else if cfg!(windows) {
        ("cmd", &["/C", "start", ""])
    } else {
        ("xdg-open", &[])
    };
    let started = Command::new(program)
        .args(arguments)
        .arg(url)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn();
    if started.is_err() {
        print::note("no browser could be opened");
    }
}

fn invalid(path: &Path, reason: &str) -> Error {
    Error::InvalidFile {
        path: path.to_owned(),
        place: String::new(),
        reason: reason.to_owned(),
    }
}
