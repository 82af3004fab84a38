defmodule MavCodec.Test.Captures do
  @moduledoc "The recordings in test/fixtures/captures, see the README there."

  @folder Path.expand("../fixtures/captures", __DIR__)

  @doc "The bytes of a recording."
  def read(name), do: @folder |> Path.join(name <> ".gz") |> File.read!() |> :zlib.gunzip()

  @doc "The frames of a tlog recording as `{microseconds, bytes}`, cut by their headers alone."
  def records(name), do: name |> read() |> records([])

  defp records(<<at::64, 0xFD, len, flags, _::binary>> = data, acc) do
    size = 12 + len + if(rem(flags, 2) == 1, do: 13, else: 0)
    <<_::64, frame::binary-size(^size), rest::binary>> = data
    records(rest, [{at, frame} | acc])
  end

  defp records(<<>>, acc), do: Enum.reverse(acc)
end
