defmodule Circuits.UART.EnumeratorTest do
  use ExUnit.Case, async: true

  alias Circuits.UART.{Device, Enumerator}

  @moduletag :tmp_dir

  # A /sys and a /dev as Linux has them: names in class/tty are links to devices, and a device links to its parent.
  setup %{tmp_dir: dir} do
    usb = "devices/pci0000:00/usb1/1-1"
    add(dir, "#{usb}/1-1:1.0", "ttyACM0")
    add(dir, "#{usb}.2/1-1.2:1.0/ttyUSB3", "ttyUSB3")
    add(dir, "devices/pnp0/00:00", "ttyS0", %{"type" => "4"})
    add(dir, "devices/platform/serial8250", "ttyS1", %{"type" => "0"})

    File.mkdir_p!(Path.join(dir, "sys/devices/virtual/tty/tty0"))
    File.ln_s!("../../devices/virtual/tty/tty0", Path.join(dir, "sys/class/tty/tty0"))

    put(dir, usb, %{
      "idVendor" => "1209",
      "idProduct" => "5741",
      "manufacturer" => "ArduPilot",
      "product" => "Pixhawk1",
      "serial" => "3E0024"
    })

    put(dir, usb <> ".2", %{"idVendor" => "10c4", "idProduct" => "nonsense", "product" => <<"CP2102 ", 0xFF>>})

    by_id = Path.join(dir, "dev/serial/by-id")
    File.mkdir_p!(by_id)
    File.ln_s!("../../ttyACM0", Path.join(by_id, "usb-ArduPilot_Pixhawk1_3E0024-if00"))
    File.write!(Path.join(by_id, "not_a_link"), "")
    {:ok, roots: [sys: Path.join(dir, "sys"), dev: Path.join(dir, "dev")], by_id: by_id}
  end

  test "finds ports with what the system knows of them", %{roots: roots, by_id: by_id} do
    assert Enumerator.enumerate(roots) == %{
             "ttyACM0" => %{
               vendor_id: 0x1209,
               product_id: 0x5741,
               manufacturer: "ArduPilot",
               description: "Pixhawk1",
               serial_number: "3E0024",
               by_id: [Path.join(by_id, "usb-ArduPilot_Pixhawk1_3E0024-if00")]
             },
             "ttyUSB3" => %{vendor_id: 0x10C4, description: "CP2102 \uFFFD"},
             "ttyS0" => %{}
           }
  end

  test "is empty where there is nothing", %{tmp_dir: dir} do
    assert Enumerator.enumerate(sys: Path.join(dir, "none"), dev: Path.join(dir, "none")) == %{}
  end

  test "of this machine is a map of maps" do
    assert Enum.all?(Circuits.UART.enumerate(), fn {name, info} -> is_binary(name) and is_map(info) end)
  end

  test "names become paths", %{roots: roots, by_id: by_id} do
    dev = roots[:dev]
    File.write!(Path.join(dev, "ttyACM0"), "")
    assert Device.path("/some/where", dev) == "/some/where"
    assert Device.path("ttyACM0", dev) == Path.join(dev, "ttyACM0")

    assert Device.path("usb-ArduPilot_Pixhawk1_3E0024-if00", dev) ==
             Path.join(by_id, "usb-ArduPilot_Pixhawk1_3E0024-if00")

    assert Device.path("serial/by-id/x", dev) == Path.join(dev, "serial/by-id/x")
    assert Device.path("nothing", dev) == Path.join(dev, "nothing")
  end

  defp add(dir, device, name, attributes \\ %{}) do
    tty = "#{device}/tty/#{name}"
    put(dir, tty, attributes)
    File.ln_s!("../../../#{Path.basename(device)}", Path.join([dir, "sys", tty, "device"]))
    class = Path.join(dir, "sys/class/tty")
    File.mkdir_p!(class)
    File.ln_s!("../../#{tty}", Path.join(class, name))
  end

  defp put(dir, folder, attributes) do
    path = Path.join([dir, "sys", folder])
    File.mkdir_p!(path)
    for {name, value} <- attributes, do: File.write!(Path.join(path, name), value <> "\n")
  end
end
