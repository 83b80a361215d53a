"""Reason codes of a PUBACK: any may come.

mosquitto answers with 0x95 to what is too large, which the standard has for other packets only. paho breaks the
connection over a code that it does not expect: the same record would be sent again for ever.
"""

from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.reasoncodes import ReasonCode


def allow_all() -> None:
    """Register with paho a name for each code that it does not expect in a PUBACK."""
    names = {code: dict(ReasonCode.names.get(code, {})) for code in range(256)}
    for code, packets_of in names.items():
        if not any(PacketTypes.PUBACK in packets for packets in packets_of.values()):
            packets_of[f"Reason code 0x{code:02x}"] = [PacketTypes.PUBACK]
    ReasonCode.names = names
