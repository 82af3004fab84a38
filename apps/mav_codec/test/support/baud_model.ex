defmodule MavCodec.Test.BaudModel do
  @moduledoc """
  What a receiver reads when it is set to another baud rate than the sender: the line of the sender's bits (8N1, lowest bit
  first) is looked at in the middle of each of the receiver's bits, from each falling edge on.
  """
  import Bitwise

  @doc "The bytes that arrive. A byte whose stop bit is low is a framing error and arrives as it was sampled."
  @spec receive(binary, pos_integer, pos_integer) :: binary
  def receive(bytes, sent_at, set_to) do
    # Idle before and after, as between two bursts.
    bits = [1, 1] ++ for(<<byte <- bytes>>, bit <- frame(byte), do: bit) ++ List.duplicate(1, 20)
    line = List.to_tuple(bits)
    ratio = sent_at / set_to
    sample(line, ratio, 0.0, [])
  end

  defp frame(byte), do: [0] ++ for(n <- 0..7, do: byte >>> n &&& 1) ++ [1]

  defp sample(line, ratio, from, read) do
    case edge(line, from) do
      nil ->
        read |> Enum.reverse() |> :erlang.list_to_binary()

      start ->
        bits = for n <- 1..8, do: at(line, start + (n + 0.5) * ratio)
        byte = bits |> Enum.with_index() |> Enum.reduce(0, fn {bit, n}, byte -> byte ||| bit <<< n end)
        sample(line, ratio, start + 9.5 * ratio, [byte | read])
    end
  end

  # The next time the line is low, in the sender's bits.
  defp edge(line, from) do
    first = ceil(from)

    cond do
      first >= tuple_size(line) -> nil
      elem(line, first) == 0 -> if(at(line, from) == 0, do: from, else: first * 1.0)
      true -> edge(line, first + 1.0)
    end
  end

  defp at(line, place) do
    index = trunc(place)
    if index < tuple_size(line), do: elem(line, index), else: 1
  end
end
