import pytest

from hardware.buses import python_can
from hardware.buses.python_can import BusSettings, bus_settings, open_bus
from hardware.errors import BusError


@pytest.fixture(autouse=True)
def no_configuration(monkeypatch, tmp_path):
    for name in ("CAN_INTERFACE", "CAN_CHANNEL", "CAN_BITRATE", "CAN_CONFIG"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("can.util.CONFIG_FILES", [str(tmp_path / "can.conf")])


def test_options_override_environment_overrides_file_overrides_default(monkeypatch, tmp_path):
    assert bus_settings() == BusSettings(interface="virtual", channel="sarcal")
    (tmp_path / "can.conf").write_text(
        "[default]\ninterface = socketcan\nchannel = can3\nbitrate = 125000\n"
    )
    assert bus_settings() == BusSettings(interface="socketcan", channel="can3", bitrate=125000)
    monkeypatch.setenv("CAN_CHANNEL", "can1")
    monkeypatch.setenv("CAN_BITRATE", "250000")
    assert bus_settings() == BusSettings(interface="socketcan", channel="can1", bitrate=250000)
    from_options = bus_settings("loopback", "can9", 1_000_000)
    assert from_options == BusSettings(interface="loopback", channel="can9", bitrate=1_000_000)


def test_other_options_of_the_file_are_passed_on(tmp_path):
    (tmp_path / "can.conf").write_text(
        "[default]\ninterface = virtual\nreceive_own_messages = true\n"
    )
    assert bus_settings().options["receive_own_messages"] is True


@pytest.mark.parametrize(
    ("variable", "value", "message"),
    [
        *(("CAN_BITRATE", rate, "bits a second") for rate in ("fast", "-5", "0", "12.5")),
        ("CAN_CONFIG", "{not json", "CAN_"),
    ],
)
def test_invalid_environment_variable_is_a_bus_error(monkeypatch, variable, value, message):
    monkeypatch.setenv(variable, value)
    with pytest.raises(BusError, match=message):
        bus_settings()


@pytest.mark.parametrize(
    ("code", "channel"), [(19, "can0"), *((code, "vcan0") for code in (1, 5, 13, 19, 93, 97, 100))]
)
def test_kernel_error_message_names_remedy(code, channel, approve):
    settings = BusSettings(interface="socketcan", channel=channel, bitrate=500_000)
    approve(python_can.describe_failure(settings, OSError(code, "something")))


@pytest.mark.parametrize("interface", ["kvaser", "neovi", "pcan", "slcan", "socketcand"])
def test_adapter_without_its_driver_is_a_bus_error(interface):
    with pytest.raises(BusError, match=rf"{interface}(?!.*\.\.)") as refused:
        open_bus(bus_settings(interface, "0", 1_000_000))
    assert ("~/can.conf" in str(refused.value)) is (interface == "socketcand")


@pytest.mark.parametrize("channel", ["a\0b", "\udc80", "\x1b[31mred", "x\ny"])
def test_unprintable_channel_is_a_printable_bus_error(channel):
    with pytest.raises(BusError, match="channel name") as refused:
        bus_settings("loopback", channel)
    assert str(refused.value).isprintable()
