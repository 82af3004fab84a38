defmodule MavCodec.Test.Hostile do
  @moduledoc """
  Bytes made to cost a parser as much as they can: for the property that they do not, and for the benchmark that shows it.
  """

  alias MavCodec.Messages
  alias MavCodec.Frame.Raw

  # FILE_TRANSFER_PROTOCOL and DEBUG: the longest payload of a version 1 message, and the id that equals its magic.
  @ftp 110
  @debug 254
  @debug_length 9

  @doc "What each makes look like a frame, and the bytes: at least `size` of them."
  @spec all(pos_integer()) :: [{String.t(), binary()}]
  def all(size) do
    for {name, pattern} <- patterns(), do: {name, :binary.copy(pattern, div(size, byte_size(pattern)) + 1)}
  end

  defp patterns do
    heartbeat = MavCodec.encode(%Messages.Heartbeat{type: 2}, system: 1)
    short = MavCodec.encode(%Messages.Ping{seq: 1}, system: 1)
    false2 = <<0xFD, 255, 0, 0, 7, 1, 1, 0, 0, 0>>

    [
      {"0xFE", <<0xFE>>},
      {"0xFD", <<0xFD>>},
      {"0xFE 0xFD", <<0xFE, 0xFD>>},
      # In each period, five headers of the right length, one byte apart.
      {"v1 headers of 254 bytes", <<0xFE, 0xFE, 0xFE, 0xFE, 0xFE, @ftp, @ftp, @ftp, @ftp>>},
      {"v1 headers of 9 bytes", <<@debug, @debug_length, @debug, @debug_length, 1>>},
      {"v2 headers", <<0xFD, 0xFD, 0, 0, 1, 1, 1, 0, 0, 0, 0>>},
      {"v2 headers with all flags", <<:binary.copy(<<0xFD>>, 8)::binary, 0::size(9)-unit(8)>>},
      {"v2 headers, signed", <<0xFD, 0xFD, 1, 1, 1, 1, 1, 0, 0, 0, 0>>},
      {"v2 headers with long ids", <<0xFE, 0xFD, 255, 6, 6, 1, 1, 1, 1, 1, 0, 0, 0, 0>>},
      {"unknown ids", <<0xFD, 0xFD, 0, 0>>},
      {"unknown ids, short", Raw.frame(54_321, <<1>>, 77, system: 1)},
      {"unknown ids around good frames", [:binary.copy(<<0xFD, 0xFD, 0, 0>>, 60), heartbeat] |> join()},
      {"unknown ids of v1 around good frames",
       [:binary.copy(<<0xFE, 250, 1, 255, 255>>, 48), heartbeat] |> join()},
      {"a false header before each good frame", false2 <> short},
      {"good frames inside a false one", [false2, List.duplicate(short, 9)] |> join()}
    ]
  end

  defp join(parts), do: IO.iodata_to_binary(parts)
end
