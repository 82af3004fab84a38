defmodule MavCodec.Sniff.Msp do
  @moduledoc """
  Finds MSP, which Betaflight and iNav speak (Q1): `$M` and `$X`, each with `<` (request), `>` (answer) or `!` (refusal).
  """

  alias MavCodec.Msp.{Frame, Parser}
  alias MavCodec.Sniff

  @doc "One finding for each version that occurs."
  @spec scan(binary) :: [Sniff.found()]
  def scan(bytes) do
    {frames, parser} = Parser.push(Parser.new(), bytes)

    for {version, frames} <- Enum.group_by(frames ++ rest(parser), &version/1), do: found(version, frames)
  end

  # What looked like half a frame at the end may hide whole ones.
  defp rest(parser) do
    case Parser.expire(parser) do
      {frames, %{buffer: ""}} -> frames
      {frames, parser} -> frames ++ rest(parser)
    end
  end

  defp version(%{form: :v2}), do: :msp2
  defp version(_frame), do: :msp1

  defp found(version, frames) do
    answers = Enum.count(frames, &(&1.direction != :request))

    %{
      protocol: version,
      units: length(frames),
      bytes: frames |> Enum.map(&byte_size(Frame.encode(&1))) |> Enum.sum(),
      chance: 0.01,
      evidence: "#{Sniff.count(length(frames), "message")}, #{answers} of them answers"
    }
  end
end
