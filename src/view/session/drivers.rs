//! Who drives the ego that is followed: the run's own driver, an agent that a viewer picked, or a viewer.

use super::{AUTOPILOT, MANUAL, RunView};
use crate::drive::{Drive, DriveError};
use crate::driver::Pilot;
use crate::telemetry::Wish;
use crate::view::wheel::Wheel;
use tokio::sync::oneshot;

/// The autopilot finds back to its route from this far (m).
const NEAR_ROUTE: f64 = 2.0;

impl RunView {
    /// Follows another ego. Who drives by hand would otherwise find themselves in another car.
    pub(super) async fn follow(
        &mut self,
        ego: usize,
        viewer: u64,
        drive: &mut Drive,
    ) -> Result<(), DriveError> {
        if self.denies(viewer, &format!("ego {}", ego + 1)) {
            return Ok(());
        }
        if self.state.holder.is_some() {
            self.give_back(drive).await?;
        }
        let name = std::mem::take(&mut self.state.driver);
        self.drivers.insert(drive.followed(), name);
        let found = drive.follow(ego);
        // A person has one wheel.
        let own = || {
            if self.setting.driver == MANUAL { AUTOPILOT.to_string() } else { self.setting.driver.clone() }
        };
        self.state.driver = self.drivers.remove(&drive.followed()).unwrap_or_else(own);
        if found {
            self.stop_loading();
            self.score.reset();
            self.hub.forget_history();
            self.say(format!("following ego {}; the sums start again", ego + 1));
        } else {
            self.say(format!("there is no ego {}", ego + 1));
        }
        Ok(())
    }

    pub(super) fn take_over(&mut self, viewer: u64, drive: &mut Drive) {
        if !self.hub.take_wheel(viewer) {
            return self.say(format!("viewer {viewer} asks for the wheel, but another one has it"));
        }
        if self.state.driver != MANUAL {
            self.state.before = Some(self.state.driver.clone());
        }
        self.hand_over(drive, Pilot::manual(), Some(MANUAL));
        self.wheel = Some(Wheel::taken_from(self.state.control));
        self.state.holder = Some(viewer);
        self.state.driver = MANUAL.to_string();
        self.stop_loading();
        self.say(format!("viewer {viewer} takes the wheel"));
    }

    /// Whether another viewer drives, who keeps what `viewer` asks for.
    pub(super) fn denies(&mut self, viewer: u64, wanted: &str) -> bool {
        let Some(holder) = self.state.holder.filter(|&holder| holder != viewer) else { return false };
        self.say(format!("viewer {viewer} asks for {wanted}, but viewer {holder} is driving"));
        true
    }

    pub(super) fn stop_loading(&mut self) {
        self.loading = None;
        self.state.loading = None;
    }

    /// The autopilot drives from now on.
    pub(super) async fn give_back(&mut self, drive: &mut Drive) -> Result<(), DriveError> {
        let by_hand = self.wheel.is_some();
        self.no_hands(AUTOPILOT, Pilot::autopilot(), drive);
        if by_hand {
            self.find_back(drive).await?;
            self.say("the autopilot drives".to_string());
        }
        Ok(())
    }

    /// After manual driving: back to the route, or to a new one.
    async fn find_back(&mut self, drive: &mut Drive) -> Result<(), DriveError> {
        let far = |drive: &Drive| drive.ego().on_route().d.abs() > NEAR_ROUTE;
        if far(drive) && !drive.grant(Wish::FindBack).await? && !drive.grant(Wish::NewRoute).await? {
            self.say("no road is near: moved to another place".to_string());
            drive.grant(Wish::Respawn).await?;
        }
        Ok(())
    }

    /// Changes the driver, and keeps the trained agent that drove before.
    fn hand_over(&mut self, drive: &mut Drive, pilot: Pilot, guest: Option<&str>) {
        let name = self.state.driver.clone();
        let before = drive.hand_over(pilot, guest.map(str::to_string));
        if before.driver.looks() {
            self.parked = Some((name, before));
        }
    }

    pub(super) async fn load(&mut self, name: String, drive: &mut Drive) -> Result<(), DriveError> {
        if self.state.driver == name || self.state.loading.as_ref() == Some(&name) {
            return Ok(());
        }
        if !self.setting.agents.contains(&name) {
            self.say(format!("there is no driver {name}"));
            return Ok(());
        }
        // From a person's hands by way of the autopilot, which finds the route again.
        if self.wheel.is_some() {
            self.give_back(drive).await?;
        }
        if self.parked.as_ref().is_some_and(|(parked, _)| *parked == name) {
            if let Some((_, driver)) = self.parked.take() {
                self.seat(name, driver, drive);
            }
            return Ok(());
        }
        let Some(make) = self.setting.make_driver.clone() else { return Ok(()) };
        let (sender, receiver) = oneshot::channel();
        let (cores, wanted) = (self.cores, name.clone());
        let work = move || {
            if let Some(cores) = cores {
                cores.confine(0);
            }
            // Nobody listens any more where another driver was picked meanwhile.
            let _ = sender.send(make(&wanted));
        };
        match std::thread::Builder::new().name("view loader".to_string()).spawn(work) {
            Ok(_) => {
                self.state.loading = Some(name.clone());
                self.loading = Some((name, receiver));
            }
            Err(error) => self.say(format!("cannot load {name}: {error}")),
        }
        Ok(())
    }

    pub(super) fn take_loaded(&mut self, drive: &mut Drive) {
        if let Some((_, loaded)) = &mut self.loading
            && let Ok(result) = loaded.try_recv()
        {
            self.loaded(result, drive);
        }
    }

    pub(super) fn loaded(&mut self, result: Result<Pilot, String>, drive: &mut Drive) {
        let Some((name, _)) = self.loading.take() else { return };
        self.state.loading = None;
        match result {
            Ok(driver) => self.seat(name, driver, drive),
            Err(why) => self.say(format!("{name} cannot drive: {why}")),
        }
        self.show_ego(drive);
    }

    fn seat(&mut self, name: String, pilot: Pilot, drive: &mut Drive) {
        #[cfg(feature = "learn")]
        crate::torch::one_thread();
        self.no_hands(&name, pilot, drive);
        self.say(format!("{name} drives"));
    }

    /// A driver that is no viewer takes the wheel.
    fn no_hands(&mut self, name: &str, pilot: Pilot, drive: &mut Drive) {
        self.wheel = None;
        self.hub.leave_wheel();
        let guest = (self.setting.driver != name).then_some(name);
        self.hand_over(drive, pilot, guest);
        self.state.holder = None;
        self.state.driver = name.to_string();
    }
}
