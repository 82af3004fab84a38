defmodule MavCodec.Sniff.Nmea do
  @moduledoc "Finds NMEA 0183, the protocol of GPS receivers and ship instruments: sentences like `$GPGGA,…*47`."

  import Bitwise

  alias MavCodec.Sniff

  @doc "At most one finding."
  @spec scan(binary) :: [Sniff.found()]
  def scan(bytes) do
    sentences =
      for [whole, body, sum] <-
            Regex.scan(~r/[$!]([A-Z]{2}[A-Z0-9]{1,5},[ -#%-)+-~]{0,100})\*([0-9A-Fa-f]{2})/, bytes),
          xor(body) == String.to_integer(sum, 16),
          do: {whole, body |> String.split(",", parts: 2) |> hd()}

    if sentences == [], do: [], else: [found(sentences)]
  end

  defp found(sentences) do
    kinds = sentences |> Enum.map(&elem(&1, 1)) |> Enum.uniq() |> Enum.sort() |> Enum.take(4)

    %{
      protocol: :nmea,
      units: length(sentences),
      # Plus the line end of each.
      bytes: sentences |> Enum.map(&(byte_size(elem(&1, 0)) + 2)) |> Enum.sum(),
      chance: 0.02,
      evidence: "#{Sniff.count(length(sentences), "sentence")} (#{Enum.join(kinds, ", ")})"
    }
  end

  defp xor(body), do: for(<<byte <- body>>, reduce: 0, do: (sum -> bxor(sum, byte)))
end
