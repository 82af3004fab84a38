defmodule Circuits.UART.Device do
  @moduledoc false
  # From the name that a caller uses to a path.

  @doc "A path stays; a name is one in `/dev`, else one in `/dev/serial/by-id`."
  @spec path(String.t(), Path.t()) :: Path.t()
  def path(name, dev \\ "/dev")
  def path("/" <> _rest = path, _dev), do: path

  def path(name, dev) do
    direct = Path.join(dev, name)
    by_id = Path.join([dev, "serial/by-id", name])
    if not File.exists?(direct) and File.exists?(by_id), do: by_id, else: direct
  rescue
    # A zero byte: no file has such a name. The port program says so.
    ArgumentError -> name
  end
end
