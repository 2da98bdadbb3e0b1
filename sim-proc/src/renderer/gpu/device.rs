//! Chooses a Vulkan adapter and opens its device.
//!
//! The device is opened through wgpu's hardware layer, because importing host memory needs a Vulkan extension that wgpu
//! does not expose.
#![expect(unsafe_code, reason = "opening a device with an extra extension goes through raw Vulkan")]

use std::fmt::Display;
use std::path::Path;

use anyhow::{Context, Error, Result, anyhow, ensure};
use wgpu::hal::vulkan;

/// What the system has where there is a graphics card: a file or folder of the kernel's own drivers, NVIDIA's or Windows's.
const DEVICE_FILES: [&str; 3] = ["/dev/dri", "/dev/nvidiactl", "/dev/dxg"];

/// An open device with its queue.
pub(in crate::renderer) struct Gpu {
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    pub(super) adapter: wgpu::AdapterInfo,
    /// The alignment of imported host memory, in bytes; `None` when the driver cannot import host memory.
    pub(super) host_import_alignment: Option<u64>,
}

impl Gpu {
    /// Waits until the device has completed everything submitted so far.
    pub(super) fn wait(&self) -> Result<()> {
        let waited = self.device.poll(wgpu::PollType::wait_indefinitely());
        waited.map(drop).map_err(device_failed)
    }
}

pub(super) fn device_failed(error: impl Display) -> Error {
    anyhow!(
        "the render device failed: {error}; start again, and if that fails too, update the driver"
    )
}

/// Opens the best graphics card, if there is one.
pub(in crate::renderer) fn open_graphics_card() -> Result<Option<Gpu>> {
    // To load all Vulkan drivers, those that render in software among them, takes a tenth of a second.
    if !DEVICE_FILES.iter().any(|file| Path::new(file).exists()) {
        return Ok(None);
    }
    let best = adapters().into_iter().next();
    let card = best.filter(|adapter| is_graphics_card(adapter.get_info().device_type));
    card.map(|adapter| open_adapter(&adapter)).transpose()
}

/// Opens the best of the adapters whose name contains `wanted` (case-insensitive).
pub(in crate::renderer) fn open(wanted: &str) -> Result<Gpu> {
    let adapters = adapters();
    ensure!(!adapters.is_empty(), "no Vulkan driver found; --backend cpu renders without one");
    let names: Vec<String> = adapters.iter().map(|a| a.get_info().name).collect();
    let chosen = names
        .iter()
        .position(|name| name.to_lowercase().contains(&wanted.to_lowercase()))
        .with_context(|| {
            format!(
                "no Vulkan adapter's name contains {wanted:?}; there are: {}; --backend cpu renders without one",
                names.join(", ")
            )
        })?;
    open_adapter(&adapters[chosen])
}

/// All Vulkan adapters, the best first.
fn adapters() -> Vec<wgpu::Adapter> {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::VULKAN;
    let instance = wgpu::Instance::new(descriptor);
    let mut adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::VULKAN));
    adapters.sort_by_key(|adapter| preference(adapter.get_info().device_type));
    adapters
}

fn is_graphics_card(kind: wgpu::DeviceType) -> bool {
    use wgpu::DeviceType::{DiscreteGpu, IntegratedGpu, VirtualGpu};
    matches!(kind, DiscreteGpu | IntegratedGpu | VirtualGpu)
}

fn preference(kind: wgpu::DeviceType) -> u8 {
    match kind {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Cpu => 3,
        wgpu::DeviceType::Other => 4,
    }
}

fn open_adapter(adapter: &wgpu::Adapter) -> Result<Gpu> {
    let info = adapter.get_info();
    let no_device =
        |reason: &dyn Display| anyhow!("cannot open the Vulkan adapter {:?}: {reason}", info.name);
    let features = wgpu::Features::empty();
    let limits = wgpu::Limits::defaults();
    let descriptor = wgpu::DeviceDescriptor {
        label: Some("renderer"),
        required_features: features,
        required_limits: limits.clone(),
        ..Default::default()
    };
    // SAFETY: the hardware-layer adapter is only borrowed while it opens a device.
    let hal = unsafe { adapter.as_hal::<vulkan::Api>() }
        .ok_or_else(|| no_device(&"it is not a Vulkan adapter"))?;
    let host_import_alignment = host_import_alignment(&hal);
    let extension = host_import_alignment.is_some().then_some(ash::ext::external_memory_host::NAME);
    // SAFETY: the callback only adds an extension that this adapter lists as supported.
    let open = unsafe {
        hal.open_with_callback(
            features,
            &limits,
            &descriptor.memory_hints,
            Some(Box::new(move |args| args.extensions.extend(extension))),
        )
    };
    let open = open.map_err(|error| no_device(&error))?;
    // SAFETY: the device was opened from this adapter with the declared features.
    let (device, queue) = unsafe { adapter.create_device_from_hal(open, &descriptor) }
        .map_err(|error| no_device(&error))?;
    drop(hal);
    Ok(Gpu { device, queue, adapter: info, host_import_alignment })
}

/// The alignment that `VK_EXT_external_memory_host` demands of pointers, if the adapter supports the extension.
fn host_import_alignment(hal: &vulkan::Adapter) -> Option<u64> {
    let extension = ash::ext::external_memory_host::NAME;
    if !hal.physical_device_capabilities().supports_extension(extension) {
        return None;
    }
    let mut host = ash::vk::PhysicalDeviceExternalMemoryHostPropertiesEXT::default();
    let mut properties = ash::vk::PhysicalDeviceProperties2::default().push_next(&mut host);
    let instance = hal.shared_instance().raw_instance();
    // SAFETY: the physical device belongs to this instance, and the chain holds one known structure.
    unsafe {
        instance.get_physical_device_properties2(hal.raw_physical_device(), &mut properties);
    }
    Some(host.min_imported_host_pointer_alignment)
}
