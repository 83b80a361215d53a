"""Reception of SAE J1939: identifiers, messages in parts, trouble codes of other devices."""
