//! Where a finished frame goes: straight into the host's pages, or through a staging buffer.
//!
//! With `VK_EXT_external_memory_host` a loaned shared-memory slot *is* the buffer that the device
//! writes, so the program never touches the pixels. Without it, or where a start-up test finds wrong
//! bytes, the frame is mapped and copied once, and the bytes so copied are counted.
//!
//! # Lifetimes
//!
//! No device work is in flight between two calls of the renderer, so the memory behind a slot is
//! written only during the call that was given the slot. Imports are cached by address. A driver may
//! tie an import to the pages that were mapped there at the time; whoever unmaps slots (a publisher
//! that is recreated) must therefore call [`Outputs::forget_imports`] before it renders into new ones.
#![expect(unsafe_code, reason = "importing host memory goes through raw Vulkan")]

use std::collections::HashMap;

use ash::vk;
use wgpu::hal::vulkan;

use super::device::Gpu;
use super::target::{BYTES_PER_PIXEL, Target};
use super::{FramePath, RenderError};

/// Imports kept before all are dropped: drivers bound the number of allocations, often at 4,096.
const IMPORT_CACHE_CAPACITY: usize = 1024;

/// What kind of memory a frame is written to.
pub enum Destination<'a> {
    /// A loaned shared-memory slot: page-aligned, whole pages, used again and again. The device
    /// writes it directly where it can.
    Slot(&'a mut [u8]),
    /// Ordinary memory: always written by one counted copy.
    Memory(&'a mut [u8]),
}

impl Destination<'_> {
    /// The destination's length in bytes.
    pub fn len(&self) -> usize {
        match self {
            Self::Slot(bytes) | Self::Memory(bytes) => bytes.len(),
        }
    }

    /// Whether the destination has no bytes at all.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    pub(super) fn bytes(&mut self) -> &mut [u8] {
        match self {
            Self::Slot(bytes) | Self::Memory(bytes) => bytes,
        }
    }
}

/// The buffer that a view's pixels are copied to by the device.
pub(super) enum Sink {
    /// The slot itself.
    Imported,
    /// A staging buffer, by its place in the batch.
    Staged(usize),
}

/// The ways out of the device, and what has been copied so far.
pub(super) struct Outputs {
    frame_bytes: u64,
    path: FramePath,
    imports: HashMap<(usize, usize), wgpu::Buffer>,
    staging: Vec<wgpu::Buffer>,
    bytes_copied: u64,
}

impl Outputs {
    /// Decides by a test which way slots are written; `force_copy` skips the test.
    pub(super) fn new(gpu: &Gpu, target: &Target, force_copy: bool) -> Self {
        let mut outputs = Self {
            frame_bytes: target.frame_bytes(),
            path: FramePath::Direct,
            imports: HashMap::new(),
            staging: Vec::new(),
            bytes_copied: 0,
        };
        let tested = if force_copy {
            Err("it was asked for".to_owned())
        } else {
            outputs.test_direct(gpu, target)
        };
        if let Err(reason) = tested {
            outputs.path = FramePath::Copied { reason };
        }
        outputs.forget_imports();
        outputs
    }

    pub(super) fn path(&self) -> &FramePath {
        &self.path
    }

    pub(super) fn bytes_copied(&self) -> u64 {
        self.bytes_copied
    }

    /// Drops every import. See the module's section on lifetimes.
    pub(super) fn forget_imports(&mut self) {
        self.imports.clear();
    }

    /// Records the way of a finished frame out of `target`: view number `place` of the batch.
    pub(super) fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        target: &Target,
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

    /// Brings staged frames home, once the device is done with the batch.
    pub(super) fn finish(
        &mut self,
        gpu: &Gpu,
        frames: Vec<(Sink, &mut Destination<'_>)>,
    ) -> Result<(), RenderError> {
        let staged: Vec<(&wgpu::Buffer, &mut [u8])> = frames
            .into_iter()
            .filter_map(|(sink, destination)| match sink {
                Sink::Imported => None,
                Sink::Staged(place) => Some((&self.staging[place], destination.bytes())),
            })
            .collect();
        if staged.is_empty() {
            return Ok(());
        }
        for (buffer, _) in &staged {
            // A failed mapping shows when its range is asked for below.
            buffer.slice(..).map_async(wgpu::MapMode::Read, |_| ());
        }
        gpu.wait()?;
        let frame_bytes = self.frame_bytes;
        for (buffer, pixels) in staged {
            let mapped = buffer.get_mapped_range(..).map_err(|error| {
                RenderError::Device(format!("a frame could not be read back: {error}"))
            })?;
            pixels[..frame_bytes as usize].copy_from_slice(&mapped);
            drop(mapped);
            buffer.unmap();
            self.bytes_copied += frame_bytes;
        }
        Ok(())
    }

    /// The slot as a buffer of the device; `None`, and copies from then on, if the driver refuses it.
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

    /// Sends a known picture into file-backed pages like a slot's and reads it there.
    fn test_direct(&mut self, gpu: &Gpu, target: &Target) -> Result<(), String> {
        let mut pages = shared_pages(self.frame_bytes)?;
        let bytes = self.frame_bytes as usize;
        let picture: Vec<u8> = (0..bytes).map(|i| (i * 7 + i / 4096 + 1) as u8).collect();
        target.fill(gpu, &picture);
        let slot = import(gpu, &mut pages)?;
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        target.copy_to(&mut encoder, &slot);
        gpu.queue.submit([encoder.finish(), host_read_barrier(gpu)]);
        gpu.wait().map_err(|error| error.to_string())?;
        if pages[..bytes] == picture[..] {
            Ok(())
        } else {
            Err("the start-up test found wrong bytes in host memory".to_owned())
        }
    }
}

/// Makes what the device wrote into imported memory visible to the host. wgpu records no such barrier,
/// because it does not know that the memory can be read by other means than mapping.
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
        // SAFETY: nothing else is recorded into this encoder, the handles live until it is finished,
        // and wgpu ends the command buffer.
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

/// Wraps `slot` as a buffer of the device, or says why the driver does not take it.
fn import(gpu: &Gpu, slot: &mut [u8]) -> Result<wgpu::Buffer, String> {
    let alignment =
        gpu.host_import_alignment.ok_or("the driver has no VK_EXT_external_memory_host")?;
    let (pointer, size) = (slot.as_mut_ptr(), slot.len() as u64);
    if !(pointer as u64).is_multiple_of(alignment) || !size.is_multiple_of(alignment) {
        return Err(format!("the slot of {size} bytes is not whole pages of {alignment} bytes"));
    }
    // SAFETY: the device is only borrowed for this function.
    let hal = unsafe { gpu.device.as_hal::<vulkan::Api>() }.ok_or("the device is not Vulkan")?;
    let device = hal.raw_device();
    let instance = hal.shared_instance().raw_instance();
    let handle_type = vk::ExternalMemoryHandleTypeFlags::HOST_ALLOCATION_EXT;
    let host = ash::ext::external_memory_host::Device::new(instance, device);
    let said = |what: &str, error: vk::Result| format!("{what}: {error}");

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
    .map_err(|error| said("vkGetMemoryHostPointerPropertiesEXT", error))?;

    let mut external = vk::ExternalMemoryBufferCreateInfo::default().handle_types(handle_type);
    let create = vk::BufferCreateInfo::default()
        .size(size)
        .usage(vk::BufferUsageFlags::TRANSFER_DST)
        .push_next(&mut external);
    // SAFETY: the structures are complete and live for the call.
    let buffer = unsafe { device.create_buffer(&create, None) }
        .map_err(|error| said("vkCreateBuffer", error))?;

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
    let bound = memory_type.ok_or("no coherent memory type takes the slot".to_owned()).and_then(
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
            // SAFETY: pointer and size are whole pages of live memory, as the extension demands. The
            // device writes them only during calls that borrow the slot (see the module's head).
            let memory = unsafe { device.allocate_memory(&allocate, None) }
                .map_err(|error| said("vkAllocateMemory", error))?;
            // SAFETY: the memory is as large as the buffer needs, and nothing else is bound to it.
            let bound = unsafe { device.bind_buffer_memory(buffer, memory, 0) };
            bound.map(|()| memory).map_err(|error| {
                // SAFETY: nothing uses the memory.
                unsafe { device.free_memory(memory, None) };
                said("vkBindBufferMemory", error)
            })
        },
    );
    let memory = bound.inspect_err(|_| {
        // SAFETY: nothing uses the buffer.
        unsafe { device.destroy_buffer(buffer, None) };
    })?;
    // SAFETY: buffer and memory were made here for each other, by this device, and their ownership
    // passes to wgpu; memory of the host counts as initialised.
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

/// Pages of a memory file: the same kind of memory as a slot's.
fn shared_pages(bytes: u64) -> Result<memmap2::MmapMut, String> {
    let pages = bytes.next_multiple_of(4096);
    let file = rustix::fs::memfd_create("renderer-self-test", rustix::fs::MemfdFlags::CLOEXEC)
        .map_err(|error| format!("memfd_create: {error}"))?;
    rustix::fs::ftruncate(&file, pages).map_err(|error| format!("ftruncate: {error}"))?;
    // SAFETY: nobody else has this file.
    unsafe { memmap2::MmapMut::map_mut(&file) }.map_err(|error| format!("mmap: {error}"))
}

/// Bytes of a frame of `width_px` x `height_px`.
pub(super) fn frame_bytes(width_px: u32, height_px: u32) -> u64 {
    u64::from(width_px) * u64::from(height_px) * BYTES_PER_PIXEL
}
