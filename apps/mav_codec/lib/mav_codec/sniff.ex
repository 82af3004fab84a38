defmodule MavCodec.Sniff do
  @moduledoc """
  Recognises the protocol of bytes from a serial line, by listening only: a pure function that accepts any bytes.

  | protocol | sign |
  |---|---|
  | `:mavlink2`, `:mavlink1` | a frame of a known message with a good CRC |
  | `:msp1`, `:msp2` | a message with a good checksum |
  | `:crsf` | frames with a good CRC, two at least |
  | `:nmea` | a sentence with a good checksum |
  | `:ublox` | a UBX message with a good checksum |
  | `:console` | readable text: boot messages, a shell |
  | `:noise` | bytes that are none of these, as with a wrong baud rate |
  | `:silence` | no bytes |

  A protocol with checksums wins over text, and one that explains more bytes over one that explains fewer. MAVLink always
  wins: a flight controller prints its boot messages on the same line.
  """

  alias MavCodec.Sniff.{Crsf, Mavlink, Msp, Nmea, Text, Ublox}

  # Scanning takes linear time in practice, but quadratic time at worst.
  @max_bytes 4_096
  # In this many bytes any known protocol would have shown a sign.
  @enough 600

  @type protocol ::
          :mavlink2
          | :mavlink1
          | :msp1
          | :msp2
          | :crsf
          | :nmea
          | :ublox
          | :console
          | :noise
          | :silence

  @typedoc """
  - `protocol`: the best explanation
  - `confidence`: 0.0 to 1.0
  - `evidence`: what was seen, in words
  - `heartbeat`: whether it includes a MAVLink heartbeat with a good CRC
  """
  @type t :: %{protocol: protocol, confidence: float, evidence: String.t(), heartbeat: boolean}

  @typedoc """
  What a scanner finds: so many `units` with good checksums, the `bytes` that they cover, and the probability that one of them
  occurs by chance.
  """
  @type found :: %{
          required(:protocol) => protocol,
          required(:units) => non_neg_integer,
          required(:bytes) => non_neg_integer,
          required(:chance) => float,
          required(:evidence) => String.t(),
          optional(:heartbeat) => boolean
        }

  @scanners [Mavlink, Msp, Nmea, Ublox, Crsf]

  @doc "How many bytes are examined at most, the latest ones."
  @spec max_bytes() :: pos_integer
  def max_bytes, do: @max_bytes

  @doc """
  Names the protocol.

      iex> MavCodec.Sniff.classify("$GPGLL,5057.970,N,00146.110,E,142451,A*27\\r\\n").protocol
      :nmea
      iex> MavCodec.Sniff.classify("").protocol
      :silence
  """
  @spec classify(binary) :: t
  def classify(""), do: result(:silence, 1.0, "nothing")

  def classify(bytes) when byte_size(bytes) > @max_bytes do
    classify(binary_part(bytes, byte_size(bytes), -@max_bytes))
  end

  def classify(bytes) when is_binary(bytes) do
    case bytes |> found() |> Enum.max_by(&rank/1, fn -> nil end) do
      nil -> unchecked(bytes)
      found -> result(found.protocol, 1 - found.chance ** found.units, found.evidence, found[:heartbeat])
    end
  end

  defp found(bytes) do
    for scanner <- @scanners, found <- scanner.scan(bytes), found.units > 0, sure?(found, bytes), do: found
  end

  # Random bytes pass an 8-bit check now and then, so CRSF has to cover at least half of the bytes.
  defp sure?(%{protocol: :crsf} = found, bytes), do: found.units >= 2 and found.bytes * 2 >= byte_size(bytes)
  defp sure?(_found, _bytes), do: true

  defp rank(%{protocol: protocol} = found) when protocol in [:mavlink1, :mavlink2], do: {1, found.bytes}
  defp rank(found), do: {0, found.bytes}

  defp unchecked(bytes) do
    case Text.scan(bytes) do
      {:text, confidence, evidence} ->
        result(:console, confidence, evidence)

      :none ->
        count = byte_size(bytes)

        result(
          :noise,
          min(0.95, count / @enough),
          "#{count} bytes of no known protocol#{pattern(bytes)}"
        )
    end
  end

  # As from an idle line, or one without common ground.
  defp pattern(bytes) do
    case for(<<byte <- bytes>>, do: byte) |> Enum.uniq() do
      [byte] -> ", all of them 0x#{Base.encode16(<<byte>>)}"
      _more -> ""
    end
  end

  defp result(protocol, confidence, evidence, heartbeat \\ false) do
    %{
      protocol: protocol,
      confidence: Float.round(confidence * 1.0, 3),
      evidence: evidence,
      heartbeat: heartbeat == true
    }
  end

  @doc """
  A number of things, for the evidence.

      iex> MavCodec.Sniff.count(1, "frame")
      "1 frame"
      iex> MavCodec.Sniff.count(3, "frame")
      "3 frames"
  """
  @spec count(non_neg_integer, String.t()) :: String.t()
  def count(1, thing), do: "1 #{thing}"
  def count(n, thing), do: "#{n} #{thing}s"

  @doc "A protocol's name for people."
  @spec name(protocol) :: String.t()
  def name(:mavlink2), do: "MAVLink 2"
  def name(:mavlink1), do: "MAVLink 1"
  def name(:msp1), do: "MSP v1"
  def name(:msp2), do: "MSP v2"
  def name(:crsf), do: "CRSF"
  def name(:nmea), do: "NMEA"
  def name(:ublox), do: "UBX"
  def name(:console), do: "console text"
  def name(:noise), do: "noise"
  def name(:silence), do: "nothing"
end
