defmodule Circuits.UART.Device do
  @moduledoc false
  # From a caller's name of a port to its path.

  @doc "A path is returned unchanged; a name is looked up in `/dev`, then in `/dev/serial/by-id`."
  @spec path(String.t(), Path.t()) :: Path.t()
  def path(name, dev \\ "/dev")
  def path("/" <> _rest = path, _dev), do: path

  def path(name, dev) do
    direct = Path.join(dev, name)
    by_id = Path.join([dev, "serial/by-id", name])
    if not File.exists?(direct) and File.exists?(by_id), do: by_id, else: direct
  rescue
    # A zero byte, which no file name has: the port program returns the error.
    ArgumentError -> name
  end
end
