defmodule Aerie.Link.Serial.Sniff do
  @moduledoc """
  What bytes of a serial line are, by listening only: a pure function, total over all bytes.

  | protocol | what counts as a sign |
  |---|---|
  | `:mavlink2`, `:mavlink1` | a frame of a known message with a good CRC |
  | `:msp1`, `:msp2` | a message with a good checksum |
  | `:crsf` | frames with a good CRC, two at least |
  | `:nmea` | a sentence with a good checksum |
  | `:ublox` | a UBX message with a good checksum |
  | `:console` | text to read: boot messages, a shell |
  | `:noise` | bytes that are none of these, as a wrong baud rate gives |
  | `:silence` | no bytes |

  Whoever has a checksum comes before who has none, and who explains more bytes before who explains fewer; MAVLink comes
  first, because a flight controller prints its boot text on the same line.
  """

  alias Aerie.Link.Serial.Sniff.{Crsf, Mavlink, Msp, Nmea, Text, Ublox}

  # Scanning is linear for what comes in practice and at worst quadratic, so there is an end to it.
  @max_bytes 4_096
  # Of noise this long every protocol would have shown itself.
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
  - `heartbeat`: whether a MAVLink heartbeat with a good CRC is among it
  """
  @type t :: %{protocol: protocol, confidence: float, evidence: String.t(), heartbeat: boolean}

  @typedoc """
  What a scanner finds: `units` complete with good checksums, the `bytes` that they cover, and the chance that one of
  them is there by accident.
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

  @doc "The most bytes that are looked at, the latest ones."
  @spec max_bytes() :: pos_integer
  def max_bytes, do: @max_bytes

  @doc """
  Names the protocol.

      iex> Aerie.Link.Serial.Sniff.classify("$GPGLL,5057.970,N,00146.110,E,142451,A*27\\r\\n").protocol
      :nmea
      iex> Aerie.Link.Serial.Sniff.classify("").protocol
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

  # A check of eight bits alone is passed now and then by anything; then most of the line has to be so.
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
          "#{count} bytes that are no known protocol#{pattern(bytes)}"
        )
    end
  end

  # What a line at rest or without ground looks like.
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
