//! Isochronous transfers of depth and colour through libusb's FFI, which `rusb` does not wrap.
//!
//! # Safety
//! All `unsafe` of this crate's default build is in this file, but for two calls of the allocator in `memory.rs`. Each block refers to a point of the argument by number:
//!
//! 1. A transfer is allocated by `libusb_alloc_transfer`, checked for null, and freed exactly once, by
//!    [`Transfer::drop`], when it is not in flight: [`Streams`] frees transfers only after `in_flight` has fallen to 0,
//!    and leaks them, their buffers, [`Callback`] and the device handle if it does not within [`DRAIN_LIMIT`].
//! 2. `in_flight` is raised before a transfer is submitted and lowered by whoever learns that it will not be called
//!    back again: the submitter if submitting failed, otherwise the callback as the last thing it does. libusb does not
//!    touch a transfer after its callback returns.
//! 3. `buffer` and `user_data` of a transfer point into a boxed slice and into an `Arc` that [`Streams`] owns, so they
//!    do not move, and by 1 they outlive every use. The kernel writes the buffer only while the transfer is in flight,
//!    and then nobody else reads it: the callback reads it after completion and before submitting again.
//! 4. The callback runs on whichever thread handles libusb's events (the event thread, or a thread in a synchronous
//!    transfer), on one at a time. It shares [`Callback`] only: atomics, and a mutex that it never waits for.
//! 5. Nothing in the callback panics: all slicing is checked, and a panic would abort at the `extern "system"` border.
//! 6. The flexible array of packet descriptors has as many entries as `libusb_alloc_transfer` was asked for, and is
//!    reached from the transfer's own raw pointer, never through a reference to the zero-length field.
#![allow(unsafe_code)]

use crate::kinect::frame_queue::PacketSink;
use crate::kinect::transport::UsbError;
use firmware_config::kinect_models::{MAX_ISO_PACKET, PACKETS_PER_TRANSFER, TRANSFERS};
use rusb::ffi::{self, constants as c};
use rusb::{Context, Device, DeviceHandle, UsbContext};
use std::ffi::c_void;
use std::ptr::{NonNull, addr_of, addr_of_mut};
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Longest wait for cancelled transfers to come back.
const DRAIN_LIMIT: Duration = Duration::from_secs(3);
/// Completions with an error in a row, over all transfers, after which the streams count as dead.
const MAX_ERRORS: u32 = 256;
/// Largest isochronous packet of a high-speed bus.
const MAX_PACKET: usize = 3072;
/// State that the callbacks of all transfers share with [`Streams`].
struct Callback {
    sink: Mutex<PacketSink>,
    stopping: AtomicBool,
    in_flight: AtomicUsize,
    errors: AtomicU32,
    epoch: Instant,
}

/// One transfer and its buffer.
struct Transfer {
    raw: NonNull<ffi::libusb_transfer>,
    /// Only the kernel and the callback touch it while the transfer is in flight (3).
    _buffer: Box<[u8]>,
}

// SAFETY: the pointer is to libusb's own allocation, which is bound to no thread; libusb locks around submitting,
// cancelling and freeing.
unsafe impl Send for Transfer {}

impl Transfer {
    fn new(
        handle: &DeviceHandle<Context>,
        endpoint: u8,
        packet_bytes: usize,
        callback: &Arc<Callback>,
    ) -> Result<Self, UsbError> {
        let mut buffer = vec![0u8; packet_bytes * PACKETS_PER_TRANSFER].into_boxed_slice();
        // SAFETY: any count is allowed; null is checked.
        let raw = unsafe { ffi::libusb_alloc_transfer(PACKETS_PER_TRANSFER as i32) };
        let raw = NonNull::new(raw).ok_or_else(|| UsbError::Other("out of memory".into()))?;
        let t = raw.as_ptr();
        // SAFETY: (1) `t` is valid and not in flight, so nobody else looks at it; (3) for the pointers stored; (6) for the
        // descriptors.
        unsafe {
            (*t).dev_handle = handle.as_raw();
            (*t).flags = 0;
            (*t).endpoint = endpoint;
            (*t).transfer_type = c::LIBUSB_TRANSFER_TYPE_ISOCHRONOUS;
            (*t).timeout = 0;
            (*t).length = buffer.len() as i32;
            (*t).callback = completed;
            (*t).user_data = Arc::as_ptr(callback).cast_mut().cast::<c_void>();
            (*t).buffer = buffer.as_mut_ptr();
            (*t).num_iso_packets = PACKETS_PER_TRANSFER as i32;
            let descriptors = addr_of_mut!((*t).iso_packet_desc).cast::<ffi::libusb_iso_packet_descriptor>();
            for k in 0..PACKETS_PER_TRANSFER {
                (*descriptors.add(k)).length = packet_bytes as u32;
            }
        }
        Ok(Self { raw, _buffer: buffer })
    }
}

impl Drop for Transfer {
    fn drop(&mut self) {
        // SAFETY: (1).
        unsafe { ffi::libusb_free_transfer(self.raw.as_ptr()) }
    }
}

/// Raises `in_flight` and submits; returns libusb's code.
fn submit(transfer: NonNull<ffi::libusb_transfer>, callback: &Callback) -> i32 {
    callback.in_flight.fetch_add(1, Ordering::AcqRel);
    // SAFETY: (1) it is valid and not in flight; (3) for its pointers.
    let code = unsafe { ffi::libusb_submit_transfer(transfer.as_ptr()) };
    if code != 0 {
        callback.in_flight.fetch_sub(1, Ordering::AcqRel);
    }
    code
}

/// Called by libusb when a transfer has completed: hands over its packets and submits it again.
extern "system" fn completed(transfer: *mut ffi::libusb_transfer) {
    let Some(transfer) = NonNull::new(transfer) else { return };
    let t = transfer.as_ptr();
    // SAFETY: (3) `user_data` is the `Callback` that `Streams` keeps alive while anything is in flight; (2) this transfer
    // counts as in flight until the end of this function.
    let (callback, status) = unsafe { (&*(*t).user_data.cast::<Callback>(), (*t).status) };
    let stopping = callback.stopping.load(Ordering::Acquire);
    let mut dead = status == c::LIBUSB_TRANSFER_NO_DEVICE || (status == c::LIBUSB_TRANSFER_CANCELLED && !stopping);
    if status == c::LIBUSB_TRANSFER_COMPLETED {
        callback.errors.store(0, Ordering::Relaxed);
        // SAFETY: (1), (3) and (6): it is over, so the buffer and the descriptors are this function's.
        unsafe { take_packets(t, callback) };
    } else if callback.errors.fetch_add(1, Ordering::Relaxed) >= MAX_ERRORS {
        dead = true;
    }
    if !stopping && !dead {
        if submit(transfer, callback) == 0 {
            // Submitting counted it once more: it is one transfer in flight.
            callback.in_flight.fetch_sub(1, Ordering::AcqRel);
            return;
        }
        // Unplugged, or refused by the bus: it does not come back.
        dead = true;
    }
    if dead && let Ok(mut sink) = callback.sink.try_lock() {
        sink.set_gone();
    }
    callback.in_flight.fetch_sub(1, Ordering::AcqRel);
}

/// Hands over the packets of a completed transfer; empty ones are normal and left out.
///
/// # Safety
/// `t` is a completed transfer made by [`Transfer::new`].
unsafe fn take_packets(t: *mut ffi::libusb_transfer, callback: &Callback) {
    // Never contended: callbacks run one at a time (4).
    let Ok(mut sink) = callback.sink.try_lock() else { return };
    let host_ns = i64::try_from(callback.epoch.elapsed().as_nanos()).unwrap_or(i64::MAX);
    // SAFETY: by the caller's promise.
    let (endpoint, buffer, descriptors) = unsafe {
        let length = usize::try_from((*t).length).unwrap_or(0);
        let descriptors = addr_of!((*t).iso_packet_desc).cast::<ffi::libusb_iso_packet_descriptor>();
        let count = usize::try_from((*t).num_iso_packets).unwrap_or(0);
        let descriptors = std::slice::from_raw_parts(descriptors, count);
        ((*t).endpoint, std::slice::from_raw_parts((*t).buffer, length), descriptors)
    };
    let mut start = 0;
    let mut flagged = 0;
    let packets = descriptors.iter().filter_map(|d| {
        // Packet k stands at k times the packet size, whatever its actual length.
        let packet = buffer.get(start..start + d.actual_length as usize);
        start += d.length as usize;
        let good = d.status == c::LIBUSB_TRANSFER_COMPLETED && d.actual_length <= d.length;
        flagged += u64::from(!good || packet.is_none());
        packet.filter(|p| good && !p.is_empty())
    });
    sink.push(endpoint, host_ns, packets);
    sink.flag(flagged);
}

/// The transfers of both endpoints, and the thread that handles libusb's events.
pub struct Streams {
    transfers: Vec<Transfer>,
    callback: Arc<Callback>,
    camera: Arc<DeviceHandle<Context>>,
    events: Option<(JoinHandle<()>, Arc<AtomicBool>)>,
}

impl Streams {
    /// Submits [`TRANSFERS`] transfers to each of the endpoints of an interface's alternate setting and handles their
    /// completions until dropped; `epoch` is the zero of the packets' host time.
    ///
    /// # Errors
    /// Unplugged, or the bus has no bandwidth left.
    pub fn start(
        camera: &Arc<DeviceHandle<Context>>,
        setting: (u8, u8),
        endpoints: &[u8],
        sink: PacketSink,
        epoch: Instant,
    ) -> Result<Self, UsbError> {
        let callback = Arc::new(Callback {
            sink: Mutex::new(sink),
            stopping: AtomicBool::new(false),
            in_flight: AtomicUsize::new(0),
            errors: AtomicU32::new(0),
            epoch,
        });
        let mut streams = Self { transfers: Vec::new(), callback, camera: Arc::clone(camera), events: None };
        for &endpoint in endpoints {
            let packet_bytes = packet_bytes(&camera.device(), setting, endpoint);
            for _ in 0..TRANSFERS {
                streams.transfers.push(Transfer::new(camera, endpoint, packet_bytes, &streams.callback)?);
            }
        }
        streams.events = Some(handle_events(camera.context().clone())?);
        for transfer in &streams.transfers {
            match submit(transfer.raw, &streams.callback) {
                0 => {}
                c::LIBUSB_ERROR_NO_DEVICE => return Err(UsbError::NoDevice),
                // ENOSPC and ENOMEM come out of libusb as an I/O error.
                c::LIBUSB_ERROR_IO | c::LIBUSB_ERROR_NO_MEM => return Err(UsbError::Bandwidth),
                code => return Err(UsbError::Other(format!("submitting a transfer failed with {code}"))),
            }
        }
        Ok(streams)
    }

    /// Cancels everything and waits until nothing is in flight; false if that took too long.
    fn drain(&self) -> bool {
        self.callback.stopping.store(true, Ordering::Release);
        let began = Instant::now();
        while self.callback.in_flight.load(Ordering::Acquire) > 0 {
            for transfer in &self.transfers {
                // SAFETY: (1) it is valid; one that is not in flight is refused by libusb. Done again and again, since a
                // callback may have submitted it just before it saw `stopping`.
                unsafe { ffi::libusb_cancel_transfer(transfer.raw.as_ptr()) };
            }
            if began.elapsed() > DRAIN_LIMIT {
                return false;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        true
    }
}

impl Drop for Streams {
    fn drop(&mut self) {
        let drained = self.drain();
        if let Some((thread, quit)) = self.events.take() {
            quit.store(true, Ordering::Release);
            if thread.join().is_err() {
                tracing::error!("the USB event thread panicked");
            }
        }
        if !drained {
            // (1): what libusb or the kernel may still write to is never freed.
            tracing::error!("USB transfers did not come back; their memory is leaked");
            std::mem::take(&mut self.transfers).into_iter().for_each(std::mem::forget);
            std::mem::forget(Arc::clone(&self.callback));
            std::mem::forget(Arc::clone(&self.camera));
        }
    }
}

/// Largest packet of the endpoint in bytes. libusb's own function considers the first alternate setting only.
fn packet_bytes(camera: &Device<Context>, (interface, alternate): (u8, u8), endpoint: u8) -> usize {
    let reported = camera.active_config_descriptor().ok().and_then(|config| {
        let interface = config.interfaces().find(|i| i.number() == interface)?;
        let setting = interface.descriptors().find(|s| s.setting_number() == alternate)?;
        let size = setting.endpoint_descriptors().find(|e| e.address() == endpoint)?.max_packet_size();
        // Bits 12 and 11 count further packets in a microframe.
        Some(usize::from(size & 0x7ff) * (1 + usize::from(size >> 11 & 3)))
    });
    reported.filter(|n| (1..=MAX_PACKET).contains(n)).unwrap_or(MAX_ISO_PACKET)
}

/// Starts the event thread, at raised priority where permitted.
fn handle_events(context: Context) -> Result<(JoinHandle<()>, Arc<AtomicBool>), UsbError> {
    let quit = Arc::new(AtomicBool::new(false));
    let seen = Arc::clone(&quit);
    let body = move || {
        if let Err(e) = rustix::process::setpriority_process(Some(rustix::thread::gettid()), -10) {
            tracing::debug!("the USB thread runs at normal priority: {e}");
        }
        while !seen.load(Ordering::Acquire) {
            if let Err(e) = context.handle_events(Some(Duration::from_millis(100))) {
                tracing::debug!("USB events: {e}");
                std::thread::sleep(Duration::from_millis(10));
            }
        }
    };
    let thread = std::thread::Builder::new().name("usb-events".into()).spawn(body);
    Ok((thread.map_err(|e| UsbError::Other(e.to_string()))?, quit))
}
