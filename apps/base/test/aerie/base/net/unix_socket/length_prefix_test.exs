defmodule Aerie.Base.Net.UnixSocket.LengthPrefixTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Net.UnixSocket.LengthPrefix

  defp wire(frames), do: frames |> Enum.map(&LengthPrefix.wrap/1) |> IO.iodata_to_binary()

  test "the length is four bytes, the least first" do
    assert IO.iodata_to_binary(LengthPrefix.wrap("0123456789")) == <<10, 0, 0, 0, "0123456789">>
  end

  test "the same bytes in any pieces give the same frames" do
    property =
      :proper.forall(
        {:proper_types.list(:proper_types.resize(280, :proper_types.binary())), :proper_types.pos_integer()},
        fn {frames, size} ->
          frames = Enum.map(frames, &("12345678" <> &1))
          {got, rest} = pieces(wire(frames), size, {[], ""})
          {got, rest} == {frames, ""}
        end
      )

    assert :proper.quickcheck(property, [:quiet, numtests: 200]) == true, inspect(:proper.counterexample())
  end

  defp pieces("", _size, {got, rest}), do: {got, rest}

  defp pieces(bytes, size, {got, rest}) do
    size = min(size, byte_size(bytes))
    <<piece::binary-size(^size), more::binary>> = bytes
    {:ok, frames, rest} = LengthPrefix.split(rest <> piece)
    assert byte_size(rest) < 292
    pieces(more, size, {got ++ frames, rest})
  end

  test "a length that no frame has is an error, as soon as it is there" do
    for length <- [0, 7, 289, 1000, 4_294_967_295],
        do: assert(LengthPrefix.split(<<length::32-little>>) == {:error, length})

    assert {:error, _length} = LengthPrefix.split(wire(["0123456789"]) <> "GET / HTTP/1.1")
    assert {:ok, [], <<9, 0, 0>>} = LengthPrefix.split(<<9, 0, 0>>)
  end
end
