#!/bin/sh
# Boots a Debian kernel under emulation with the host's root folder read-only, and runs guest.py in it. See README.md.
# boot.sh WORDS runs the checks whose names begin so.
set -eu
KERNEL=6.1.0-56-amd64
HERE=$(cd "$(dirname "$0")" && pwd)
REPO=$(cd "$HERE/../../.." && pwd)
LAB=$REPO/.kernel_lab
MODULES=$LAB/kernel/lib/modules/$KERNEL
mkdir -p "$LAB/debs/partial" "$LAB/tools" "$LAB/kernel"

tool() { LD_LIBRARY_PATH=$LAB/tools/usr/lib/x86_64-linux-gnu:$LAB/tools/lib/x86_64-linux-gnu "$@"; }

# Packages are unpacked here, not installed.
if [ ! -e "$MODULES/modules.dep" ]; then
    (cd "$LAB/debs" && apt-get download -qq busybox-static cpio kmod "linux-image-$KERNEL")
    apt-get install -y -qq --no-install-recommends --download-only -o "Dir::Cache::archives=$LAB/debs" qemu-system-x86
    for package in "$LAB"/debs/*.deb; do
        case $package in
            */linux-image-*) dpkg -x "$package" "$LAB/kernel" ;;
            *) dpkg -x "$package" "$LAB/tools" ;;
        esac
    done
    cp "$LAB/tools/bin/kmod" "$LAB/depmod" # kmod acts by the name that it is called by
    tool "$LAB/depmod" -b "$LAB/kernel" $KERNEL
fi

# The ramdisk holds what is needed to reach the host's root folder; everything else is loaded from there.
DISK=$LAB/ramdisk
rm -rf "$DISK"
mkdir -p "$DISK/bin" "$DISK/proc" "$DISK/sys" "$DISK/dev" "$DISK/mnt" "$DISK/lib/modules"
cp "$LAB/tools/bin/busybox" "$DISK/bin/"
for applet in sh mount insmod modprobe ln ifconfig chroot poweroff; do ln -s busybox "$DISK/bin/$applet"; done
INSERT=
for module in virtio_ring virtio virtio_pci_modern_dev virtio_pci_legacy_dev virtio_pci 9pnet 9pnet_virtio netfs fscache 9p; do
    cp "$(find "$MODULES" -name "$module.ko")" "$DISK/lib/modules/"
    INSERT="$INSERT insmod /lib/modules/$module.ko;"
done
cat > "$DISK/init" <<END
#!/bin/sh
mount -t proc proc /proc; mount -t sysfs sysfs /sys; mount -t devtmpfs dev /dev
$INSERT
mount -t 9p -o trans=virtio,version=9p2000.L,ro,msize=512000,cache=loose root0 /mnt
ln -s "/mnt$MODULES" /lib/modules/$KERNEL
ifconfig lo 127.0.0.1 up
modprobe vhci-hcd; modprobe uvcvideo; modprobe brd rd_nr=3 rd_size=65536; modprobe dm-log-writes; modprobe crc32c_generic; modprobe ext4
mount -t devtmpfs dev /mnt/dev; mount -t sysfs sysfs /mnt/sys; mount -t proc proc /mnt/proc; mount -t tmpfs run /mnt/run
export HOME=/root TMPDIR=/run PATH=/usr/sbin:/usr/bin:/sbin:/bin OMP_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE=1
chroot /mnt "$REPO/.venv/bin/python" "$HERE/guest.py" $*
poweroff -f
END
chmod +x "$DISK/init"
(cd "$DISK" && find . | tool "$LAB/tools/bin/cpio" -o -H newc --quiet > "$LAB/ramdisk.img")

tool timeout 1800 "$LAB/tools/usr/bin/qemu-system-x86_64" -L "$LAB/tools/usr/share/qemu" -L "$LAB/tools/usr/share/seabios" \
    -machine q35 -accel tcg,thread=multi -cpu max -smp 2 -m 3G -nographic -no-reboot -net none \
    -kernel "$LAB/kernel/boot/vmlinuz-$KERNEL" -initrd "$LAB/ramdisk.img" -append "console=ttyS0 quiet panic=-1 no_timer_check" \
    -virtfs local,path=/,mount_tag=root0,security_model=none,readonly=on,multidevs=remap < /dev/null | tee "$LAB/log"
grep -q "KERNEL LAB PASSED" "$LAB/log"
