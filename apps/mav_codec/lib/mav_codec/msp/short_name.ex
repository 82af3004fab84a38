defmodule MavCodec.Msp.ShortName do
  @longest 16

  @moduledoc "Names of parameters for MAVLink, which takes #{@longest} characters."

  @doc """
  The name itself if it is short enough. A longer one keeps its beginning, and gets a mark that follows from the whole of it.

      iex> MavCodec.Msp.ShortName.of("p_roll")
      "p_roll"
      iex> MavCodec.Msp.ShortName.of("vbat_min_cell_voltage")
      "vbat_min_ce~2d74"
  """
  @spec of(String.t()) :: String.t()
  def of(name) when byte_size(name) <= @longest, do: name

  def of(name) do
    mark = <<MavCodec.CRC.x25(name)::16>> |> Base.encode16(case: :lower)
    binary_slice(name, 0, @longest - 5) <> "~" <> mark
  end
end
