defmodule MavCodec.Sniff.Words do
  @moduledoc "Counted nouns."

  @doc """
  A number of things.

      iex> MavCodec.Sniff.Words.count(1, "frame")
      "1 frame"
      iex> MavCodec.Sniff.Words.count(3, "frame")
      "3 frames"
  """
  @spec count(non_neg_integer, String.t()) :: String.t()
  def count(1, thing), do: "1 #{thing}"
  def count(n, thing), do: "#{n} #{thing}s"
end
