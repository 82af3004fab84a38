defmodule MavCodec.Sniff.Mavlink do
  @moduledoc "Finds MAVLink 1 and 2: frames of known messages with a good CRC."

  alias MavCodec.Sniff
  alias MavCodec.Frame
  alias MavCodec.Parser

  @heartbeat MavCodec.Messages.Heartbeat.id()

  @doc "One finding for each version that occurs."
  @spec scan(binary) :: [Sniff.found()]
  def scan(bytes) do
    {frames, parser} = Parser.push(Parser.new(), bytes)
    {last, _parser} = Parser.flush(parser)

    (frames ++ last)
    |> Enum.filter(& &1.crc_extra)
    |> Enum.group_by(& &1.version)
    |> Enum.map(fn {version, frames} -> found(version, frames) end)
  end

  @doc "Whether a frame is a heartbeat whose CRC was checked."
  @spec heartbeat?(Frame.t()) :: boolean
  def heartbeat?(%Frame{id: id, crc_extra: extra}), do: id == @heartbeat and extra != nil

  defp found(version, frames) do
    %{
      protocol: if(version == 1, do: :mavlink1, else: :mavlink2),
      units: length(frames),
      bytes: frames |> Enum.map(&byte_size(&1.bytes)) |> Enum.sum(),
      chance: 0.001,
      evidence: "#{Sniff.count(length(frames), "frame")} of #{systems(frames)}, #{heartbeats(frames)}",
      heartbeat: Enum.any?(frames, &heartbeat?/1)
    }
  end

  defp systems(frames) do
    case frames |> Enum.map(& &1.system) |> Enum.uniq() do
      [system] -> "system #{system}"
      systems -> "#{length(systems)} systems"
    end
  end

  defp heartbeats(frames) do
    if Enum.any?(frames, &heartbeat?/1), do: "a heartbeat among them", else: "no heartbeat among them"
  end
end
