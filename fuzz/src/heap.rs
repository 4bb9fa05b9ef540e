//! An allocation that no input of the fuzzer's size justifies is a fault like a panic.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Bytes that one allocation may have now.
static LIMIT: AtomicUsize = AtomicUsize::new(usize::MAX);

struct Limited;

// SAFETY: every call goes to the system's allocator unchanged, or the process ends.
unsafe impl GlobalAlloc for Limited {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        check(layout.size());
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        check(layout.size());
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        unsafe { System.dealloc(memory, layout) }
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, bytes: usize) -> *mut u8 {
        check(bytes);
        unsafe { System.realloc(memory, layout, bytes) }
    }
}

#[global_allocator]
static HEAP: Limited = Limited;

fn check(bytes: usize) {
    if bytes > LIMIT.load(Ordering::Relaxed) {
        LIMIT.store(usize::MAX, Ordering::Relaxed);
        // libFuzzer keeps the input of a process that aborts.
        eprintln!("an allocation of {bytes} bytes\n{}", std::backtrace::Backtrace::force_capture());
        std::process::abort();
    }
}

/// Lifts the limit while a panic is reported: its backtrace reads what debug information there is.
pub fn spare_reports() {
    let report = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        LIMIT.store(usize::MAX, Ordering::Relaxed);
        report(panic);
    }));
}

/// Runs `body`, in which no allocation may be larger than `most_bytes`.
pub fn limited(most_bytes: usize, body: impl FnOnce()) {
    LIMIT.store(most_bytes, Ordering::Relaxed);
    body();
    LIMIT.store(usize::MAX, Ordering::Relaxed);
}
