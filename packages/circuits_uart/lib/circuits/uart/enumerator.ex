defmodule Circuits.UART.Enumerator do
  @moduledoc false
  # Lists the serial ports from sysfs. It opens none, because opening can reset the device.

  @usb_texts [description: "product", manufacturer: "manufacturer", serial_number: "serial"]
  @usb_ids [vendor_id: "idVendor", product_id: "idProduct"]

  # How many folders up the USB device of a tty can be.
  @levels 8

  @doc "`roots` are for tests: `:sys` and `:dev`."
  @spec enumerate(keyword()) :: %{String.t() => map()}
  def enumerate(roots \\ []) do
    sys = Keyword.get(roots, :sys, "/sys")
    by_id = by_id(Keyword.get(roots, :dev, "/dev"))

    for name <- list(Path.join(sys, "class/tty")),
        device = real_device(Path.join([sys, "class/tty", name])),
        into: %{} do
      {name, device |> usb_info(@levels) |> put_by_id(Map.get(by_id, name))}
    end
  end

  # A tty without a device is a console or a PTY; type 0 is a UART that the kernel reserved but did not find.
  defp real_device(tty) do
    case real_path(Path.join(tty, "device")) do
      {:ok, device} -> if read(Path.join(tty, "type")) != "0", do: device
      :error -> nil
    end
  end

  defp usb_info(_device, 0), do: %{}

  defp usb_info(device, levels) do
    if File.exists?(Path.join(device, "idVendor")),
      do: Map.merge(collect(device, @usb_texts, & &1), collect(device, @usb_ids, &hex/1)),
      else: usb_info(Path.dirname(device), levels - 1)
  end

  defp collect(device, fields, convert) do
    for {key, file} <- fields,
        text = read(Path.join(device, file)),
        value = convert.(text),
        into: %{},
        do: {key, value}
  end

  defp hex(text) do
    case Integer.parse(text, 16) do
      {number, ""} -> number
      _other -> nil
    end
  end

  defp put_by_id(info, nil), do: info
  defp put_by_id(info, paths), do: Map.put(info, :by_id, Enum.sort(paths))

  # Each name is a link such as ../../ttyACM0.
  defp by_id(dev) do
    folder = Path.join(dev, "serial/by-id")

    for link <- list(folder), {:ok, target} <- [File.read_link(Path.join(folder, link))], reduce: %{} do
      names ->
        Map.update(names, Path.basename(target), [Path.join(folder, link)], &[Path.join(folder, link) | &1])
    end
  end

  defp list(folder) do
    case File.ls(folder) do
      {:ok, names} -> names
      {:error, _reason} -> []
    end
  end

  # The descriptors of USB devices can contain any bytes.
  defp read(file) do
    with {:ok, text} <- File.read(file),
         text when text != "" <- text |> String.replace_invalid() |> String.trim() do
      text
    else
      _nothing -> nil
    end
  end

  # The target of a link; its parent folders are the devices to which it belongs.
  defp real_path(link) do
    case File.read_link(link) do
      {:ok, target} -> {:ok, target |> Path.expand(real_parent(link))}
      {:error, :einval} -> {:ok, link}
      {:error, _reason} -> :error
    end
  end

  # class/tty/<name> is itself a link into devices/...
  defp real_parent(link) do
    parent = Path.dirname(link)

    case File.read_link(parent) do
      {:ok, target} -> Path.expand(target, Path.dirname(parent))
      {:error, _reason} -> parent
    end
  end
end
