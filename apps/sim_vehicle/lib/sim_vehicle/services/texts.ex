defmodule SimVehicle.Services.Texts do
  @moduledoc """
  STATUSTEXT of any length in chunks of 50 bytes (rule X2).
  """

  @doc """
  The chunks of a text. The end is a chunk shorter than 50 bytes: a text of exactly 50 or 100 bytes is followed by an
  empty one.
  """
  @spec split(String.t()) :: [String.t()]
  def split(<<chunk::binary-size(50), rest::binary>>), do: [chunk | split(rest)]
  def split(rest), do: [rest]
end
