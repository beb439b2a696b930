#!/bin/sh
# make_certificates.sh FOLDER BROKER NAME...: a certificate authority of the plant, the broker's certificate, and one for
# each client, whose name is the user name in rules.acl. Files that are there are kept: run it again for a new client.
# Take ca.key off this machine afterwards: who has it can be any station. BROKER is the name that clients connect to.
set -eu
[ $# -ge 2 ] || { echo "usage: $0 FOLDER BROKER NAME..." >&2; exit 2; }
folder=$1; broker=$2; shift 2
umask 077
mkdir -p "$folder"
cd "$folder"

[ -f ca.key ] || openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 7300 -subj "/CN=gelgate plant CA" \
    -addext "basicConstraints=critical,CA:TRUE" -addext "keyUsage=critical,keyCertSign,cRLSign" \
    -keyout ca.key -out ca.crt 2>/dev/null

# make FILE NAME USAGE: a key and a certificate for ten years
make() {
    [ ! -f "$1.crt" ] || return 0
    openssl req -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -subj "/CN=$2" -keyout "$1.key" -out "$1.csr" 2>/dev/null
    printf 'basicConstraints=CA:FALSE\nextendedKeyUsage=%s\nsubjectAltName=DNS:%s,DNS:localhost,IP:127.0.0.1\n' "$3" "$2" > "$1.ext"
    openssl x509 -req -in "$1.csr" -CA ca.crt -CAkey ca.key -CAcreateserial -days 3650 -extfile "$1.ext" -out "$1.crt" 2>/dev/null
    rm "$1.csr" "$1.ext"
    chmod 0644 "$1.crt"
    echo "$folder/$1.crt"
}

chmod 0644 ca.crt
make broker "$broker" serverAuth
for name in "$@"; do make "$name" "$name" clientAuth; done
