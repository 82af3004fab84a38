defmodule Aerie.Base.Net.SerialPortsTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Net.SerialPorts

  # Devices that every machine has, in place of serial ports.
  setup do
    dev = Path.join(System.tmp_dir!(), "aerie-ports-#{System.unique_integer([:positive])}")
    File.mkdir_p!(Path.join(dev, "serial/by-id"))
    on_exit(fn -> File.rm_rf(dev) end)
    {:ok, dev: dev}
  end

  defp make(dev, name, target), do: File.ln_s!(target, Path.join(dev, name))

  defp names(options),
    do: for(%{path: path, origin: origin} <- SerialPorts.list(options), do: {Path.basename(path), origin})

  test "configured, by-id, ACM, USB, each device once", %{dev: dev} do
    make(dev, "ttyUSB10", "/dev/null")
    make(dev, "ttyUSB9", "/dev/zero")
    make(dev, "ttyACM0", "/dev/full")
    make(dev, "ttyACM1", "/dev/random")
    make(dev, "ttyS0", "/dev/urandom")
    make(dev, "console", "/dev/tty")
    make(dev, "serial/by-id/usb-ArduPilot_Pixhawk1-if00", "../../ttyACM0")
    make(dev, "serial/by-id/usb-gone", "../../ttyACM7")

    assert names(%{dev: dev}) == [
             {"usb-ArduPilot_Pixhawk1-if00", :by_id},
             {"ttyACM1", :acm},
             {"ttyUSB9", :usb},
             {"ttyUSB10", :usb}
           ]

    configured = [Path.join(dev, "ttyS0"), "ttyUSB10", "ttyNONE"]

    assert [{"ttyS0", :configured}, {"ttyUSB10", :configured}, {"ttyNONE", :configured} | rest] =
             names(%{dev: dev, ports: configured})

    assert [{_, :by_id}, {"ttyACM1", :acm}, {"ttyUSB9", :usb}] = rest
    assert names(%{dev: dev, ports: ["ttyUSB9"], only: true}) == [{"ttyUSB9", :configured}]
    refute {"ttyUSB9", :usb} in names(%{dev: dev, taken: ["/dev/zero"]})
  end

  test "no folder, no ports; the number of ports is bounded", %{dev: dev} do
    assert SerialPorts.list(%{dev: "/nowhere"}) == []
    ports = for n <- 1..40, do: "/nowhere/tty#{n}"
    assert length(SerialPorts.list(%{dev: dev, ports: ports})) == 16
  end

  test "the fingerprint changes when a device comes, goes, or becomes another", %{dev: dev} do
    options = %{dev: dev}
    none = SerialPorts.fingerprint(options)
    make(dev, "ttyACM0", "/dev/null")
    one = SerialPorts.fingerprint(options)
    assert one != none and one == SerialPorts.fingerprint(options)
    File.rm!(Path.join(dev, "ttyACM0"))
    assert SerialPorts.fingerprint(options) == none
    make(dev, "ttyACM0", "/dev/zero")
    assert SerialPorts.fingerprint(options) not in [none, one]
  end
end
