defmodule MavCodec.Test.MspTranscript do
  @moduledoc "What real firmware answered, in `test/fixtures/msp`. Benchmarks read it, too."

  alias MavCodec.Msp.Messages

  @folder Path.expand("../fixtures/msp", __DIR__)
  @transcripts %{betaflight: "betaflight_4.5.5", inav: "inav_9.0.0"}

  @doc "What was sent to a simulator of the firmware, and what came back: `{at, at, request, reply}`, seconds, nil if nothing came."
  @spec read(Messages.firmware()) :: [{float, float | nil, binary, binary | nil}]
  def read(firmware) do
    text = Path.join(@folder, "#{@transcripts[firmware]}.txt.gz") |> File.read!() |> :zlib.gunzip()

    for line <- String.split(text, "\n", trim: true), not String.starts_with?(line, "#") do
      [asked, answered, request, reply] = String.split(line)
      {seconds(asked), seconds(answered), bytes(request), bytes(reply)}
    end
  end

  defp seconds("-"), do: nil
  defp seconds(text), do: String.to_float(text)
  defp bytes("-"), do: nil
  defp bytes(hex), do: Base.decode16!(hex, case: :lower)
end
