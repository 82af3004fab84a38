defmodule Aerie.Base.Net.SerialPorts do
  @moduledoc """
  The serial ports of a search: those of the configuration first, then `/dev/serial/by-id/*` (names that stay the same
  whichever socket the cable is in), `/dev/ttyACM*` and `/dev/ttyUSB*`. A port with several names is listed once, by the first
  of them. Only lists names, opens nothing.

  Ports of the machine itself (`ttyS0`, `ttyAMA0`, `ttyTHS1`) are used only if the configuration names them: one of them is
  often the machine's console.
  """

  @max_ports 16

  @typedoc """
  - `path`: the name to open it by
  - `key`: identifies the device whatever its name; nil if it does not exist
  - `origin`: why it is in the list
  """
  @type port_name :: %{path: Path.t(), key: term, origin: :configured | :by_id | :acm | :usb}

  @typedoc """
  - `ports`: names of the configuration, default none
  - `only`: whether only these are used, default false
  - `dev`: the folder of devices, default `/dev`
  - `taken`: names of ports that other links use
  """
  @type options :: %{
          optional(:ports) => [Path.t()],
          optional(:only) => boolean,
          optional(:dev) => Path.t(),
          optional(:taken) => [Path.t()]
        }

  @doc "The ports in order of preference, at most #{@max_ports}."
  @spec list(options) :: [port_name]
  def list(options) do
    dev = Map.get(options, :dev, "/dev")
    taken = for path <- Map.get(options, :taken, []), key = key(absolute(path, dev)), do: key

    (configured(options, dev) ++ if(options[:only], do: [], else: found(dev)))
    |> Enum.reject(&(&1.key in taken))
    |> Enum.uniq_by(&(&1.key || &1.path))
    |> Enum.take(@max_ports)
  end

  @doc """
  A value that changes when ports come, go, or change their permissions.
  """
  @spec fingerprint(options) :: non_neg_integer
  def fingerprint(options) do
    :erlang.phash2(for %{path: path, key: key} <- list(options), do: {path, key, changed(path)})
  end

  defp changed(path) do
    with {:ok, stat} <- File.stat(path, time: :posix), do: {stat.ctime, stat.inode}
  end

  defp configured(options, dev) do
    for name <- Map.get(options, :ports, []), path = absolute(name, dev) do
      %{path: path, key: key(path), origin: :configured}
    end
  end

  defp found(dev) do
    by_id = Path.join(dev, "serial/by-id")
    names = names(dev)

    for {folder, names, origin} <- [
          {by_id, names(by_id), :by_id},
          {dev, Enum.filter(names, &String.starts_with?(&1, "ttyACM")), :acm},
          {dev, Enum.filter(names, &String.starts_with?(&1, "ttyUSB")), :usb}
        ],
        name <- Enum.sort_by(names, &natural/1),
        path = Path.join(folder, name),
        # No key: a symbolic link that udev has not removed yet.
        key = key(path) do
      %{path: path, key: key, origin: origin}
    end
  end

  defp names(folder) do
    case File.ls(folder) do
      {:ok, names} -> names
      {:error, _none} -> []
    end
  end

  # ttyUSB10 after ttyUSB9.
  defp natural(name), do: {String.replace(name, ~r/\d+/, ""), byte_size(name), name}

  defp absolute("/" <> _rest = path, _dev), do: path
  defp absolute(name, dev), do: Path.join(dev, name)

  # The number of the device, symbolic links followed; a file that is not a device has its inode.
  defp key(path) do
    case File.stat(path) do
      {:ok, %File.Stat{type: :device, minor_device: number}} -> {:device, number}
      {:ok, %File.Stat{inode: inode, major_device: disk}} -> {:file, disk, inode}
      {:error, _none} -> nil
    end
  end
end
