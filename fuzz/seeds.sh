#!/bin/sh
# Writes fuzz/seeds from the golden vectors: one file for each frame. Needs xxd.
set -eu
cd "$(dirname "$0")"
vectors=../firmware-protocol/vectors
(cd seeds && rm -rf rtu_receiver tcp_receiver stream_decoder slave_pdu)
mkdir -p seeds/rtu_receiver seeds/tcp_receiver seeds/stream_decoder seeds/slave_pdu
write() { # target, skip bytes at the front, skip at the end; hexadecimal lines on stdin
    number=0
    while read -r line; do
        number=$((number + 1))
        bytes=$(printf '%s' "$line" | tr -d ' ')
        length=$((${#bytes} / 2))
        printf '%s' "$bytes" | xxd -r -p | tail -c +$(($2 + 1)) | head -c $((length - $2 - $3)) >"seeds/$1/$number"
    done
}
sed -n 's/^> //p' $vectors/modbus-rtu.txt | write rtu_receiver 0 0
sed -n 's/^> //p' $vectors/modbus-tcp.txt | write tcp_receiver 0 0
sed -n 's/^> //p' $vectors/modbus-tcp.txt | write slave_pdu 7 0
grep -v -e '^#' -e '^$' $vectors/stream.txt | write stream_decoder 0 0
