defmodule Msp.Test.Recorded do
  @moduledoc """
  A flight controller made of a transcript: it answers a request with the reply that the real one gave to the same request last, at the
  same time of the recording, or first, if it had not been asked before.
  """

  @folder Path.expand("../../../mav_codec/test/fixtures/msp", __DIR__)

  @doc "The function that answers for `Msp.Test.Line`; its time begins `from` seconds after the recording's start."
  def answers(name, from) do
    # Newest first.
    replies =
      for line <- name |> lines(),
          [asked, _answered, request, reply] = String.split(line),
          reply != "-",
          reduce: %{},
          do: (all ->
                 Map.update(
                   all,
                   bytes(request),
                   [{at(asked), bytes(reply)}],
                   &[{at(asked), bytes(reply)} | &1]
                 ))

    fn request, us ->
      now = from + us / 1_000_000
      known = Map.get(replies, request, [])

      case Enum.find(known, fn {asked, _reply} -> asked <= now end) || List.last(known) do
        {_asked, reply} -> reply
        nil -> nil
      end
    end
  end

  defp lines(name) do
    text = Path.join(@folder, "#{name}.txt.gz") |> File.read!() |> :zlib.gunzip()
    for line <- String.split(text, "\n", trim: true), not String.starts_with?(line, "#"), do: line
  end

  defp at(seconds), do: String.to_float(seconds)
  defp bytes(hex), do: Base.decode16!(hex, case: :lower)
end
