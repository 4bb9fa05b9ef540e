//! A USB bus with a simulated Kinect on it.

use crate::kinect::transport::{Bus, Found, Transport, UsbError};
use crate::lock::lock;
use crate::simulator::device::SimKinect;
use crate::simulator::plan::SimPlan;
use crate::simulator::shared::Shared;
#[cfg(test)]
use crate::simulator::shared::SimLog;
use std::sync::Arc;
use std::time::Duration;

/// Serial number of the simulated Kinect.
pub const SERIAL: &str = "SIMULATED0000001";

/// A USB bus with a simulated Kinect on it.
#[derive(Clone)]
pub struct SimBus {
    plan: Arc<SimPlan>,
    shared: Arc<Shared>,
}

impl SimBus {
    /// A bus with a device that follows the plan.
    #[must_use]
    pub fn new(plan: SimPlan) -> Self {
        Self { shared: Arc::new(Shared::new(plan.fast)), plan: Arc::new(plan) }
    }

    /// The device's log so far.
    #[cfg(test)]
    #[must_use]
    pub fn log(&self) -> SimLog {
        lock(&self.shared.log).clone()
    }

    /// What the clock shows. The simulated one also runs while the reader waits, longer on a slow machine.
    #[cfg(test)]
    #[must_use]
    pub fn now(&self) -> Duration {
        self.shared.now()
    }
}

impl Bus for SimBus {
    fn list(&mut self) -> Result<Vec<Found>, UsbError> {
        let now = self.shared.now();
        let mut log = lock(&self.shared.log);
        if let Some(at) = log.unplugged_at {
            match self.plan.replug_after() {
                Some(after) if now >= at + after => log.unplugged_at = None,
                _ => {
                    drop(log);
                    self.shared.pause(Duration::from_millis(if self.plan.fast { 50 } else { 0 }));
                    return Ok(Vec::new());
                }
            }
        }
        Ok(vec![Found {
            model: self.plan.model,
            serial: SERIAL.into(),
            bus: 1,
            path: "1".into(),
            address: 2,
            accessible: true,
        }])
    }

    fn is_here(&mut self, _found: &Found) -> bool {
        self.shared.is_plugged()
    }

    fn open(&mut self, _found: &Found) -> Result<Box<dyn Transport>, UsbError> {
        if !self.shared.is_plugged() {
            return Err(UsbError::NoDevice);
        }
        let session = {
            let mut log = lock(&self.shared.log);
            log.opens += 1;
            log.over = false;
            log.opens
        };
        let plan = self.plan.of_session(session);
        lock(&self.shared.registers).clear();
        Ok(Box::new(SimKinect::new(plan, Arc::clone(&self.shared))))
    }
}
