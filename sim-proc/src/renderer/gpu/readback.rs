//! Moves finished frames from the device to the host: straight into the host's pages, or through a staging buffer.
//!
//! With `VK_EXT_external_memory_host`, a loaned shared-memory slot *is* the buffer that the device writes, and the program
//! never touches the pixels. Without it, or where a start-up test finds wrong bytes, each frame is mapped and copied once,
//! and the copied bytes are counted.
//!
//! # Lifetimes
//!
//! No device work is in flight between two calls of the renderer, so the memory behind a slot is written only during the
//! call that was given the slot. Imports are cached by address. A driver may tie an import to the pages that were mapped
//! there at the time. After slots are unmapped (when a publisher is recreated), [`Readback::forget_imports`] must be called
//! before frames go to new ones.
#![expect(unsafe_code, reason = "importing host memory goes through raw Vulkan")]

use std::collections::HashMap;

use anyhow::Result;
use ash::vk;
use wgpu::hal::vulkan;

use super::device::{Gpu, device_failed};
use super::target::RenderTarget;
use crate::renderer::job::Destination;
use crate::renderer::settings::FramePath;

/// Imports cached before all are dropped. Drivers limit the number of allocations, often to 4,096.
const IMPORT_CACHE_CAPACITY: usize = 1024;

/// Where the device copies the pixels of a view.
pub(super) enum Sink {
    /// Into the slot itself.
    Imported,
    /// Into the staging buffer of this number.
    Staged(usize),
}

/// Imported slots, staging buffers, and what has been copied so far.
pub(super) struct Readback {
    frame_bytes: u64,
    path: FramePath,
    imports: HashMap<(usize, usize), wgpu::Buffer>,
    staging: Vec<wgpu::Buffer>,
    bytes_copied: u64,
}

impl Readback {
    /// Tests whether the device can write into host memory; `force_copy` skips the test and copies.
    pub(super) fn new(gpu: &Gpu, target: &RenderTarget, force_copy: bool) -> Self {
        let mut readback = Self {
            frame_bytes: target.frame_bytes(),
            path: FramePath::Direct,
            imports: HashMap::new(),
            staging: Vec::new(),
            bytes_copied: 0,
        };
        let tested = if force_copy {
            Err("copying was requested".to_owned())
        } else {
            readback.test_direct(gpu, target)
        };
        if let Err(reason) = tested {
            readback.path = FramePath::Copied { reason };
        }
        readback.forget_imports();
        readback
    }

    pub(super) fn path(&self) -> &FramePath {
        &self.path
    }

    pub(super) fn bytes_copied(&self) -> u64 {
        self.bytes_copied
    }

    /// Drops all imports. See the section on lifetimes above.
    pub(super) fn forget_imports(&mut self) {
        self.imports.clear();
    }

    /// Records the copy of the finished frame in `target`, the batch's view number `place`, to its destination.
    pub(super) fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        target: &RenderTarget,
        place: usize,
        destination: &mut Destination<'_>,
    ) -> Sink {
        let imported = match destination {
            Destination::Slot(bytes) if matches!(self.path, FramePath::Direct) => {
                self.import(gpu, bytes)
            }
            Destination::Slot(_) | Destination::Memory(_) => None,
        };
        if let Some(buffer) = imported {
            target.copy_to(encoder, &buffer);
            return Sink::Imported;
        }
        while self.staging.len() <= place {
            self.staging.push(gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("staged frame"),
                size: self.frame_bytes,
                usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
                mapped_at_creation: false,
            }));
        }
        target.copy_to(encoder, &self.staging[place]);
        Sink::Staged(place)
    }

    /// Copies staged frames to their destinations after the device has completed the batch.
    pub(super) fn finish(
        &mut self,
        gpu: &Gpu,
        frames: Vec<(Sink, &mut Destination<'_>)>,
    ) -> Result<()> {
        let staged: Vec<(&wgpu::Buffer, &mut [u8])> = frames
            .into_iter()
            .filter_map(|(sink, destination)| match sink {
                Sink::Imported => None,
                Sink::Staged(place) => Some((&self.staging[place], destination.bytes_mut())),
            })
            .collect();
        if staged.is_empty() {
            return Ok(());
        }
        for (buffer, _) in &staged {
            // If mapping fails, `get_mapped_range` below reports it.
            buffer.slice(..).map_async(wgpu::MapMode::Read, |_| ());
        }
        gpu.wait()?;
        let frame_bytes = self.frame_bytes;
        for (buffer, pixels) in staged {
            let mapped = buffer.get_mapped_range(..).map_err(|error| {
                device_failed(format_args!("a frame could not be read back: {error}"))
            })?;
            pixels[..frame_bytes as usize].copy_from_slice(&mapped);
            drop(mapped);
            buffer.unmap();
            self.bytes_copied += frame_bytes;
        }
        Ok(())
    }

    /// The slot as a buffer of the device. If the driver refuses it, `None`, and frames are copied from then on.
    fn import(&mut self, gpu: &Gpu, slot: &mut [u8]) -> Option<wgpu::Buffer> {
        let place = (slot.as_mut_ptr() as usize, slot.len());
        if let Some(buffer) = self.imports.get(&place) {
            return Some(buffer.clone());
        }
        if self.imports.len() >= IMPORT_CACHE_CAPACITY {
            self.forget_imports();
        }
        match import(gpu, slot) {
            Ok(buffer) => {
                self.imports.insert(place, buffer.clone());
                Some(buffer)
            }
            Err(reason) => {
                tracing::warn!(%reason, "the device cannot write into a slot; frames are copied");
                self.path = FramePath::Copied { reason };
                None
            }
        }
    }

    /// Lets the device write a known image into pages like a slot's, and compares the bytes.
    fn test_direct(&mut self, gpu: &Gpu, target: &RenderTarget) -> Result<(), String> {
        let mut pages = shared_pages(self.frame_bytes)?;
        let bytes = self.frame_bytes as usize;
        let image: Vec<u8> = (0..bytes).map(|i| (i * 7 + i / 4096 + 1) as u8).collect();
        target.fill(gpu, &image);
        let slot = import(gpu, &mut pages)?;
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        target.copy_to(&mut encoder, &slot);
        gpu.queue.submit([encoder.finish(), host_read_barrier(gpu)]);
        gpu.wait().map_err(|error| error.to_string())?;
        if pages[..bytes] == image[..] {
            Ok(())
        } else {
            Err("the start-up test found wrong bytes in host memory".to_owned())
        }
    }
}

/// Makes the device's writes into imported memory visible to the host. wgpu records no such barrier, because it does not
/// know that the memory is read other than by mapping.
pub(super) fn host_read_barrier(gpu: &Gpu) -> wgpu::CommandBuffer {
    let mut encoder = gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("host barrier") });
    // SAFETY: the device is only borrowed for the call.
    let device = unsafe { gpu.device.as_hal::<vulkan::Api>() };
    let barrier = vk::MemoryBarrier::default()
        .src_access_mask(vk::AccessFlags::TRANSFER_WRITE)
        .dst_access_mask(vk::AccessFlags::HOST_READ);
    if let Some(device) = device {
        // SAFETY: nothing else is recorded into this encoder, the handles outlive it, and wgpu ends the command
        // buffer.
        unsafe {
            encoder.as_hal_mut::<vulkan::Api, _, _>(|hal| {
                if let Some(hal) = hal {
                    device.raw_device().cmd_pipeline_barrier(
                        hal.raw_handle(),
                        vk::PipelineStageFlags::TRANSFER,
                        vk::PipelineStageFlags::HOST,
                        vk::DependencyFlags::empty(),
                        &[barrier],
                        &[],
                        &[],
                    );
                }
            });
        }
    }
    encoder.finish()
}

/// Wraps `slot` as a buffer of the device.
///
/// # Errors
/// The reason why the driver does not accept it.
fn import(gpu: &Gpu, slot: &mut [u8]) -> Result<wgpu::Buffer, String> {
    let alignment =
        gpu.host_import_alignment.ok_or("the driver has no VK_EXT_external_memory_host")?;
    let (pointer, size) = (slot.as_mut_ptr(), slot.len() as u64);
    if !(pointer as u64).is_multiple_of(alignment) || !size.is_multiple_of(alignment) {
        return Err(format!("a slot of {size} bytes is not made of pages of {alignment} bytes"));
    }
    // SAFETY: the device is only borrowed for this function.
    let hal = unsafe { gpu.device.as_hal::<vulkan::Api>() }.ok_or("the device is not Vulkan")?;
    let device = hal.raw_device();
    let instance = hal.shared_instance().raw_instance();
    let handle_type = vk::ExternalMemoryHandleTypeFlags::HOST_ALLOCATION_EXT;
    let host = ash::ext::external_memory_host::Device::new(instance, device);
    let failed = |what: &str, error: vk::Result| format!("{what}: {error}");

    let mut pointer_properties = vk::MemoryHostPointerPropertiesEXT::default();
    // SAFETY: the pointer is that of a live slice of `size` bytes.
    unsafe {
        (host.fp().get_memory_host_pointer_properties_ext)(
            device.handle(),
            handle_type,
            pointer.cast(),
            &mut pointer_properties,
        )
    }
    .result()
    .map_err(|error| failed("vkGetMemoryHostPointerPropertiesEXT", error))?;

    let mut external = vk::ExternalMemoryBufferCreateInfo::default().handle_types(handle_type);
    let create = vk::BufferCreateInfo::default()
        .size(size)
        .usage(vk::BufferUsageFlags::TRANSFER_DST)
        .push_next(&mut external);
    // SAFETY: the structures are complete and live for the call.
    let buffer = unsafe { device.create_buffer(&create, None) }
        .map_err(|error| failed("vkCreateBuffer", error))?;

    // SAFETY: the buffer and the physical device are of this device and instance.
    let (needs, memory) = unsafe {
        (
            device.get_buffer_memory_requirements(buffer),
            instance.get_physical_device_memory_properties(hal.raw_physical_device()),
        )
    };
    let bits = needs.memory_type_bits & pointer_properties.memory_type_bits;
    let wanted = vk::MemoryPropertyFlags::HOST_VISIBLE | vk::MemoryPropertyFlags::HOST_COHERENT;
    let memory_type = memory
        .memory_types_as_slice()
        .iter()
        .enumerate()
        .position(|(i, kind)| bits & (1 << i) != 0 && kind.property_flags.contains(wanted));
    let bound = memory_type.ok_or("no coherent memory type accepts the slot".to_owned()).and_then(
        |memory_type| {
            if needs.size > size {
                return Err(format!("the driver needs {} bytes for {size}", needs.size));
            }
            let mut source = vk::ImportMemoryHostPointerInfoEXT::default()
                .handle_type(handle_type)
                .host_pointer(pointer.cast());
            let allocate = vk::MemoryAllocateInfo::default()
                .allocation_size(size)
                .memory_type_index(memory_type as u32)
                .push_next(&mut source);
            // SAFETY: pointer and size are whole pages of live memory, as the extension demands. The device
            // writes them only during calls that borrow the slot (see "Lifetimes" above).
            let memory = unsafe { device.allocate_memory(&allocate, None) }
                .map_err(|error| failed("vkAllocateMemory", error))?;
            // SAFETY: the memory is as large as the buffer needs, and nothing else is bound to it.
            let bound = unsafe { device.bind_buffer_memory(buffer, memory, 0) };
            bound.map(|()| memory).map_err(|error| {
                // SAFETY: nothing uses the memory.
                unsafe { device.free_memory(memory, None) };
                failed("vkBindBufferMemory", error)
            })
        },
    );
    let memory = bound.inspect_err(|_| {
        // SAFETY: nothing uses the buffer.
        unsafe { device.destroy_buffer(buffer, None) };
    })?;
    // SAFETY: buffer and memory were created here for each other by this device, their ownership passes to wgpu, and
    // host memory counts as initialised.
    Ok(unsafe {
        let managed = vulkan::Buffer::from_raw_managed(buffer, memory, 0, size);
        gpu.device.create_buffer_from_hal::<vulkan::Api>(
            managed,
            &wgpu::BufferDescriptor {
                label: Some("imported slot"),
                size,
                usage: wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            },
        )
    })
}

/// Pages of a memory file, the kind of memory that slots are made of.
fn shared_pages(bytes: u64) -> Result<memmap2::MmapMut, String> {
    let pages = bytes.next_multiple_of(4096);
    let file = rustix::fs::memfd_create("renderer-self-test", rustix::fs::MemfdFlags::CLOEXEC)
        .map_err(|error| format!("memfd_create: {error}"))?;
    rustix::fs::ftruncate(&file, pages).map_err(|error| format!("ftruncate: {error}"))?;
    // SAFETY: nothing else has this file open.
    unsafe { memmap2::MmapMut::map_mut(&file) }.map_err(|error| format!("mmap: {error}"))
}
