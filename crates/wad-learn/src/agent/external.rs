//! An external process as an agent, over a pipe: a model in any language can be evaluated without linking.
//!
//! Lines of JSON, one object each (docs/evaluate.md):
//!
//! 1. The process writes one line when it is ready: `{"image": true}` to be sent the front image, or `{}`.
//! 2. Each tick it is sent one line:
//!    `{"episode", "tick", "seed", "raw": [15], "latent": [200], "state": {...}, "image": "base64 of a PNG"}`.
//!    `tick` 0 begins an episode. `raw` and `state` are [`RawState`]'s numbers, scaled and in units.
//! 3. It answers each with `{"throttle": 0..1, "steer": -1..1, "brake": 0..1}` within the time limit.
//!
//! At the end it is killed with all processes that it has started; so it is if this program dies. If it dies, hangs or gives an invalid
//! answer, the episode fails, and a new process is started for the next one.

use super::{Agent, AgentError, Seen};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use sumo_traci::keeper;
use wad_camera::Picture;
use wad_see::observation::{Observation, RawState};
use wad_vehicle::Control;

/// Time limits of an external agent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// From the start to the first line. Default 60 s: importing a deep-learning library takes time.
    pub start: Duration,
    /// For each answer. Default 10 s.
    pub answer: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        Self { start: Duration::from_secs(60), answer: Duration::from_secs(10) }
    }
}

impl Limits {
    /// With `seconds` for each answer; None: that is no time above 0.
    pub fn answer_within(seconds: f64) -> Option<Self> {
        let answer = Duration::try_from_secs_f64(seconds).ok().filter(|limit| !limit.is_zero())?;
        Some(Self { answer, ..Self::default() })
    }
}

/// An agent in another process.
pub struct ExternalAgent {
    name: String,
    command: String,
    limits: Limits,
    process: Option<Process>,
    episode: u64,
    tick: u64,
    seed: u64,
}

/// Lines of its standard error that an error message quotes.
const TAIL: usize = 3;
/// Longest answer (bytes).
const LONGEST_LINE: u64 = 1 << 16;

#[derive(Default, Deserialize)]
#[serde(default)]
struct Hello {
    image: bool,
}

#[derive(Serialize)]
struct Question<'a> {
    episode: u64,
    tick: u64,
    seed: u64,
    raw: &'a [f32],
    latent: &'a [f32],
    #[serde(skip_serializing_if = "Option::is_none")]
    state: Option<&'a RawState>,
    #[serde(skip_serializing_if = "Option::is_none")]
    image: Option<String>,
}

#[derive(Deserialize)]
struct Answer {
    throttle: f64,
    steer: f64,
    brake: f64,
}

impl ExternalAgent {
    /// The agent of the shell command `command`. The process starts with the first episode.
    pub fn new(command: &str, limits: Limits) -> Self {
        Self {
            name: format!("exec:{command}"),
            command: command.to_string(),
            limits,
            process: None,
            episode: 0,
            tick: 0,
            seed: 0,
        }
    }

    fn ask(&mut self, observation: &Observation, seen: Option<&Seen<'_>>) -> Result<Control, String> {
        let process = match &mut self.process {
            Some(process) => process,
            none => none.insert(Process::start(&self.command, self.limits.start)?),
        };
        if let Ok(line) = process.lines.try_recv() {
            return Err(match line {
                Some(line) => format!("it wrote a line without a request: {}", shortened(&line)),
                None => process.died(),
            });
        }
        let image = match (process.wants_image, seen.and_then(|seen| seen.frame)) {
            (true, Some(frame)) if !frame.rgb.is_empty() => {
                let png = Picture::rgb(frame).png().map_err(|e| format!("its picture: {e}"))?;
                Some(base64(&png))
            }
            _ => None,
        };
        let question = Question {
            episode: self.episode,
            tick: self.tick,
            seed: self.seed,
            raw: &observation.raw,
            latent: &observation.latent,
            state: seen.map(|seen| seen.raw),
            image,
        };
        let mut line = serde_json::to_vec(&question).map_err(|e| e.to_string())?;
        line.push(b'\n');
        // The writer ends only if the pipe is broken; the reader then reports why.
        let _ = process.questions.send(line);
        self.tick += 1;
        let answer = process.line(self.limits.answer)?;
        read_control(&answer)
    }
}

/// An external agent's answer to a question.
///
/// # Errors
/// It is no control, or one out of range; the text quotes its beginning.
pub fn read_control(line: &str) -> Result<Control, String> {
    let expected = "expected {\"throttle\": 0..1, \"steer\": -1..1, \"brake\": 0..1}";
    let answer: Answer = serde_json::from_str(line)
        .map_err(|e| format!("it answered {}: {expected} ({e})", shortened(line)))?;
    let within = |x: f64, low: f64| (low - 1e-6..=1.0 + 1e-6).contains(&x);
    if !(within(answer.throttle, 0.0) && within(answer.steer, -1.0) && within(answer.brake, 0.0)) {
        return Err(format!("it answered {}: {expected}", shortened(line)));
    }
    Ok(Control { throttle: answer.throttle, steer: answer.steer, brake: answer.brake, reverse: false }
        .clamped())
}

fn shortened(line: &str) -> String {
    let mut text: String = line.chars().take(80).collect();
    if text.len() < line.len() {
        text += "...";
    }
    format!("`{text}`")
}

impl Agent for ExternalAgent {
    fn name(&self) -> &str {
        &self.name
    }

    fn reset(&mut self, seed: u64) {
        self.episode += 1;
        (self.tick, self.seed) = (0, seed);
    }

    fn act(&mut self, observation: &Observation) -> Result<Control, AgentError> {
        let result = self.ask(observation, None);
        self.judged(result)
    }

    fn act_seeing(&mut self, seen: &Seen<'_>) -> Result<Control, AgentError> {
        let result = self.ask(seen.observation, Some(seen));
        self.judged(result)
    }
}

impl ExternalAgent {
    fn judged(&mut self, result: Result<Control, String>) -> Result<Control, AgentError> {
        result.map_err(|why| {
            self.process = None;
            AgentError::Failed { name: self.name.clone(), why }
        })
    }
}

/// The process, with a thread for each of its pipes, so that a hung process does not block us.
struct Process {
    child: Child,
    wants_image: bool,
    questions: Sender<Vec<u8>>,
    /// None: the end of its output.
    lines: Receiver<Option<String>>,
    tail: Arc<Mutex<VecDeque<String>>>,
}

impl Process {
    fn start(command: &str, limit: Duration) -> Result<Self, String> {
        let mut guard = Command::new("sh");
        guard.args(["-c", GUARD, "sh", command]);
        guard.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        // A process group of its own: its children end with it, and Ctrl-C comes to us only.
        guard.process_group(0);
        adopt_orphans(&mut guard);
        let mut child =
            keeper::spawn(guard, libc::SIGTERM).map_err(|e| format!("it cannot be started: {e}"))?;
        let (questions, asked) = channel::<Vec<u8>>();
        let (said, lines) = channel();
        let tail = Arc::new(Mutex::new(VecDeque::new()));
        if let Some(mut stdin) = child.stdin.take() {
            std::thread::spawn(move || {
                for line in asked {
                    if stdin.write_all(&line).and_then(|()| stdin.flush()).is_err() {
                        break;
                    }
                }
            });
        }
        if let Some(stdout) = child.stdout.take() {
            std::thread::spawn(move || {
                let mut reader = BufReader::new(stdout);
                while let Some(line) = next_line(&mut reader) {
                    if !line.trim().is_empty() && said.send(Some(line)).is_err() {
                        return;
                    }
                }
                let _ = said.send(None);
            });
        }
        if let Some(stderr) = child.stderr.take() {
            let tail = Arc::clone(&tail);
            std::thread::spawn(move || {
                let mut reader = BufReader::new(stderr);
                while let Some(line) = next_line(&mut reader) {
                    tracing::info!("agent: {line}");
                    let mut tail = tail.lock().unwrap_or_else(PoisonError::into_inner);
                    tail.push_back(line);
                    while tail.len() > TAIL {
                        tail.pop_front();
                    }
                }
            });
        }
        let mut process = Self { child, wants_image: false, questions, lines, tail };
        let first = process.line(limit)?;
        let hello: Hello = serde_json::from_str(&first).map_err(|e| {
            format!("its first line was {}: expected {{}} or {{\"image\": true}} ({e})", shortened(&first))
        })?;
        process.wants_image = hello.image;
        Ok(process)
    }

    fn line(&mut self, limit: Duration) -> Result<String, String> {
        match self.lines.recv_timeout(limit) {
            Ok(Some(line)) => Ok(line),
            Ok(None) | Err(RecvTimeoutError::Disconnected) => Err(self.died()),
            Err(RecvTimeoutError::Timeout) => {
                Err(format!("it hung: no answer within {:.0} s{}", limit.as_secs_f64(), self.said()))
            }
        }
    }

    /// How the process ended, once its output has ended.
    fn died(&mut self) -> String {
        let until = Instant::now() + Duration::from_millis(500);
        loop {
            match self.child.try_wait() {
                Ok(Some(status)) => {
                    // Its last lines may not have been read yet.
                    std::thread::sleep(Duration::from_millis(50));
                    return format!("it died ({status}){}", self.said());
                }
                Ok(None) if Instant::now() < until => std::thread::sleep(Duration::from_millis(10)),
                _ => return format!("it closed its output{}", self.said()),
            }
        }
    }

    fn said(&self) -> String {
        let tail = self.tail.lock().unwrap_or_else(PoisonError::into_inner);
        let lines: Vec<&str> = tail.iter().map(|line| line.trim()).filter(|line| !line.is_empty()).collect();
        if lines.is_empty() { String::new() } else { format!("; it said: {}", lines.join(" / ")) }
    }
}

/// Runs the agent `$1`, and ends all that it has started: when it ends by itself, or when this shell gets SIGTERM.
///
/// Orphans, those with a session of their own too, become children of this shell ([`adopt_orphans`]), so killing
/// its children until it has none leaves nobody. Where the kernel does not list them, the process group is killed.
const GUARD: &str = r#"
sweep() {
    passes=0
    while [ $passes -lt 100 ]; do
        children=
        read -r children < "/proc/$$/task/$$/children"
        [ -n "$children" ] || break
        kill -KILL $children
        # Waiting collects the dead too.
        sh -c : & wait $!
        passes=$((passes + 1))
    done
}
trap 'trap "" TERM; sweep; kill -KILL 0' TERM
exec 3<&0
sh -c "$1" <&3 3<&- &
exec 3<&- </dev/null >/dev/null 2>&1
wait $!
code=$?
sweep
exit $code
"#;

#[cfg(target_os = "linux")]
fn adopt_orphans(command: &mut Command) {
    let before_exec = || {
        // SAFETY: prctl is async-signal-safe and touches no memory of ours. It fails before Linux 3.4 only.
        unsafe { libc::prctl(libc::PR_SET_CHILD_SUBREAPER, 1) };
        Ok(())
    };
    // SAFETY: the closure runs between fork and exec, and allocates nothing.
    unsafe { command.pre_exec(before_exec) };
}

#[cfg(not(target_os = "linux"))]
fn adopt_orphans(_command: &mut Command) {}

/// How long the guard may take to end the agent's processes.
const PATIENCE: Duration = Duration::from_secs(2);

impl Drop for Process {
    fn drop(&mut self) {
        let Ok(pid) = i32::try_from(self.child.id()) else { return };
        // SAFETY: sends a signal to a child that has not been waited for, or whose end `died` has seen: then its
        // number leads a group that is still ours, or none.
        let signal = |pid, signal| unsafe { libc::kill(pid, signal) };
        let until = Instant::now() + PATIENCE;
        if matches!(self.child.try_wait(), Ok(None)) {
            signal(pid, libc::SIGTERM);
            while matches!(self.child.try_wait(), Ok(None)) && Instant::now() < until {
                std::thread::sleep(Duration::from_millis(2));
            }
        }
        signal(-pid, libc::SIGKILL);
        // An error means that it has ended already.
        let _ = self.child.wait();
    }
}

/// The next line, cut off where it is far too long; None at the end.
fn next_line(reader: &mut impl BufRead) -> Option<String> {
    let mut bytes = Vec::new();
    let read = reader.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut bytes).ok()?;
    (read > 0).then(|| String::from_utf8_lossy(&bytes).trim_end_matches(['\n', '\r']).to_string())
}

/// RFC 4648 with padding.
pub fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let word = chunk.iter().fold(0_u32, |word, &b| word << 8 | u32::from(b)) << (8 * (3 - chunk.len()));
        for digit in 0..4 {
            let known = digit <= chunk.len();
            let index = (word >> (18 - 6 * digit)) as usize & 63;
            text.push(if known { DIGITS[index] as char } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn agent(command: &str) -> ExternalAgent {
        let limits = Limits { start: Duration::from_secs(10), answer: Duration::from_millis(700) };
        ExternalAgent::new(command, limits)
    }

    fn act(agent: &mut ExternalAgent) -> Result<Control, String> {
        let observation = Observation { latent: vec![0.5; 200], raw: [0.25; 15] };
        agent.act(&observation).map_err(|e| e.to_string())
    }

    const GOOD: &str =
        "echo '{}'; while read -r line; do echo '{\"throttle\": 0.5, \"steer\": -0.25, \"brake\": 0}'; done";

    #[test]
    fn it_is_asked_and_answers() {
        let mut agent = agent(GOOD);
        for seed in [1, 2] {
            agent.reset(seed);
            for _ in 0..3 {
                assert_eq!(
                    act(&mut agent),
                    Ok(Control { throttle: 0.5, steer: -0.25, brake: 0.0, reverse: false })
                );
            }
        }
    }

    #[test]
    fn dying_hanging_and_nonsense_cost_an_episode_and_say_why() {
        for (command, expected) in [
            ("echo lost its weights >&2; exit 3", "exit status: 3); it said: lost its weights"),
            ("echo '{}'; read -r line; exit 4", "it died (exit status: 4)"),
            ("echo '{}'; sleep 100", "it hung: no answer within 1 s"),
            ("echo '{}'; read -r line; echo hello", "it answered `hello`"),
            (
                "echo '{}'; read -r line; echo '{\"throttle\": 7, \"steer\": 0, \"brake\": 0}'",
                "steer\": -1..1",
            ),
            ("echo '{}'; read -r line; echo '{\"throttle\": null}'", "throttle"),
            ("echo ready; sleep 100", "its first line was `ready`"),
            ("no-such-program-here", "it died"),
        ] {
            let mut agent = agent(command);
            agent.reset(1);
            let error = act(&mut agent).unwrap_err();
            assert!(error.contains(expected), "{command}: {error}");
        }
    }

    #[test]
    fn after_a_failure_a_new_process_drives_the_next_episode() {
        let folder = tempfile::tempdir().unwrap();
        let mark = folder.path().join("mark").display().to_string();
        let mut agent = agent(&format!("if test -e {mark}; then {GOOD}; else touch {mark}; fi"));
        agent.reset(1);
        assert!(act(&mut agent).is_err());
        agent.reset(2);
        assert!(act(&mut agent).is_ok());
    }

    fn is_gone(pid: &str) -> bool {
        let stat = || std::fs::read_to_string(format!("/proc/{}/stat", pid.trim())).unwrap_or_default();
        let dead = |stat: String| stat.rsplit(')').next().is_none_or(|s| s.is_empty() || s.starts_with(" Z"));
        (0..500).any(|_| {
            std::thread::sleep(Duration::from_millis(10));
            dead(stat())
        })
    }

    #[test]
    fn nothing_that_it_started_outlives_it() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| folder.path().join(name).display().to_string();
        // A child, a grandchild, and two that left the group.
        let started = format!(
            "sleep 1000 & echo $! >{}; setsid sleep 1000 & echo $! >{}; setsid sh -c 'sleep 1000 & echo $! >{}; wait' & \
             sleep 0.2; ",
            file("a"),
            file("b"),
            file("c")
        );
        for end in [GOOD, "echo '{}'; read -r line; exit 4"] {
            let mut agent = agent(&format!("{started}{end}"));
            agent.reset(1);
            assert_eq!(act(&mut agent).is_ok(), end == GOOD);
            drop(agent);
            for name in ["a", "b", "c"] {
                let pid = std::fs::read_to_string(file(name)).unwrap();
                assert!(is_gone(&pid), "{name} of {end}");
            }
        }
    }

    #[test]
    fn base64_as_in_its_standard() {
        for (text, expected) in
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")]
        {
            assert_eq!(base64(text.as_bytes()), expected);
        }
    }
}
