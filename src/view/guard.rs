//! Access to the server: allowed hosts, tokens, message limits.
//!
//! Any page in the user's browser can send requests to a loopback port. So the `Host` must be this
//! machine's (a foreign name that points here is refused), and where the browser names an `Origin`,
//! it must be that host. Beyond loopback a token is asked for.

use std::fmt;
use std::net::IpAddr;
use std::str::FromStr;
use std::time::Instant;

/// A secret that a viewer must know.
#[derive(Clone, PartialEq, Eq)]
pub struct Token(String);

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(...)")
    }
}

/// Fewest characters of a token.
const SHORTEST_TOKEN: usize = 8;

impl FromStr for Token {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_.~".contains(c);
        if text.len() < SHORTEST_TOKEN || !text.chars().all(plain) {
            return Err(format!(
                "a token has at least {SHORTEST_TOKEN} characters out of a-z, A-Z, 0-9, - _ . ~ (it is part of the page's address)"
            ));
        }
        Ok(Self(text.to_string()))
    }
}

impl Token {
    /// The token as it stands in the page's address.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// Whether `query` (`a=b&token=...`) holds it, in constant time.
    fn is_in(&self, query: Option<&str>) -> bool {
        let found = query.unwrap_or("").split('&').find_map(|pair| pair.strip_prefix("token="));
        let (found, own) = (found.unwrap_or("").as_bytes(), self.0.as_bytes());
        found.len() == own.len() && found.iter().zip(own).fold(0, |all, (a, b)| all | (a ^ b)) == 0
    }
}

/// The rules of access.
#[derive(Clone, Debug)]
pub struct Guard {
    /// The server listens on loopback only.
    pub loopback: bool,
    pub token: Option<Token>,
}

/// Why a request is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    Host,
    Origin,
    Token,
}

impl Refusal {
    pub fn text(self) -> &'static str {
        match self {
            Self::Host => "this page is at 127.0.0.1 or localhost, under no other name",
            Self::Origin => "another site's page may not talk to this one",
            Self::Token => "the address needs ?token=..., as --view-token says",
        }
    }
}

impl Guard {
    /// Whether a request with these headers and this query may come in.
    ///
    /// # Errors
    /// The reason of the refusal.
    pub fn check(
        &self,
        host: Option<&str>,
        origin: Option<&str>,
        query: Option<&str>,
    ) -> Result<(), Refusal> {
        let host = host.unwrap_or("");
        if self.loopback && !is_loopback(host) {
            return Err(Refusal::Host);
        }
        if let Some(origin) = origin {
            let of = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
            if !of.is_some_and(|of| of.eq_ignore_ascii_case(host)) {
                return Err(Refusal::Origin);
            }
        }
        match &self.token {
            Some(token) if !token.is_in(query) => Err(Refusal::Token),
            _ => Ok(()),
        }
    }
}

/// Whether a `Host` header (`name[:port]`) names this machine whatever a name server says.
fn is_loopback(host: &str) -> bool {
    let name = match host.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or(""),
        None => host.split(':').next().unwrap_or(""),
    };
    name.eq_ignore_ascii_case("localhost") || name.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback())
}

/// The limit of a viewer's messages: a rate per second, and a burst.
#[derive(Debug)]
pub struct Budget {
    left: f64,
    last: Instant,
}

const PER_SECOND: f64 = 200.0;
const AT_ONCE: f64 = 400.0;

impl Budget {
    pub fn new(now: Instant) -> Self {
        Self { left: AT_ONCE, last: now }
    }

    /// Whether one more message is within the limit.
    pub fn spend(&mut self, now: Instant) -> bool {
        let passed = now.duration_since(self.last).as_secs_f64();
        self.left = (self.left + PER_SECOND * passed).min(AT_ONCE) - 1.0;
        self.last = now;
        self.left >= 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn only_this_machines_own_page_comes_in() {
        let guard = Guard { loopback: true, token: None };
        let ok = |host, origin| guard.check(Some(host), origin, None);
        assert_eq!(ok("127.0.0.1:8765", None), Ok(()));
        assert_eq!(ok("localhost:9000", Some("http://localhost:9000")), Ok(()));
        assert_eq!(ok("[::1]:8765", Some("http://[::1]:8765")), Ok(()));
        assert_eq!(ok("evil.example:8765", None), Err(Refusal::Host));
        assert_eq!(ok("127.0.0.1.evil.example", None), Err(Refusal::Host));
        assert_eq!(guard.check(None, None, None), Err(Refusal::Host));
        assert_eq!(ok("127.0.0.1:8765", Some("http://evil.example")), Err(Refusal::Origin));
        assert_eq!(ok("127.0.0.1:8765", Some("http://127.0.0.1:80")), Err(Refusal::Origin));
        assert_eq!(ok("127.0.0.1:8765", Some("null")), Err(Refusal::Origin));
    }

    #[test]
    fn beyond_loopback_the_token_is_asked_for() {
        let token: Token = "correct-horse".parse().unwrap();
        let guard = Guard { loopback: false, token: Some(token) };
        let ask = |query| guard.check(Some("car.local:8765"), None, query);
        assert_eq!(ask(Some("a=1&token=correct-horse")), Ok(()));
        for wrong in [None, Some(""), Some("token="), Some("token=correct-hors"), Some("token=correct-horsf")]
        {
            assert_eq!(ask(wrong), Err(Refusal::Token), "{wrong:?}");
        }
        assert!("short".parse::<Token>().is_err() && "with space in".parse::<Token>().is_err());
    }

    #[test]
    fn a_budget_is_spent_and_comes_back() {
        let start = Instant::now();
        let mut budget = Budget::new(start);
        let spent = (0..1000).take_while(|_| budget.spend(start)).count();
        assert_eq!(spent, AT_ONCE as usize);
        assert!(budget.spend(start + Duration::from_secs(1)));
    }
}
