defmodule Aerie.Mission.Transfer.Compare do
  @moduledoc """
  Compares the plan that was read back with the one that was sent (W8): floats as 32 bits, without `current`, and only fields that the
  firmware stores.
  """

  alias Aerie.Mission.Item

  @mission 0

  @doc "`:same`, or the number of the first item that differs, and how."
  @spec plans([Item.t()], [Item.t()], 0..2, module()) :: :same | {:differs, non_neg_integer(), String.t()}
  def plans(sent, read, type, protocol) do
    # The vehicle sets home when it is armed, whatever was sent; a cleared mission may keep it.
    first = if type == @mission and protocol.home_is_item_0?(), do: 1, else: 0
    {sent, read} = {Enum.drop(sent, first), Enum.drop(read, first)}

    difference =
      sent
      |> Enum.zip(read)
      |> Enum.with_index(first)
      |> Enum.find_value(fn {{a, b}, seq} -> item(a, b, seq, protocol) end)

    cond do
      difference -> difference
      length(sent) == length(read) -> :same
      true -> shorter(length(sent) + first, length(read) + first)
    end
  end

  defp shorter(sent, read),
    do: {:differs, min(sent, read), "the vehicle has #{read} items and not #{sent}"}

  defp item(a, b, seq, protocol) do
    [a, b] = for item <- [a, b], do: item |> protocol.stored_item() |> Item.rounded()

    if a == b do
      nil
    else
      {name, sent, read} = field(a, b)
      {:differs, seq, "item #{seq} has #{name} #{inspect(read)} and not #{inspect(sent)}"}
    end
  end

  defp field(a, b) do
    names =
      [:command, :frame, :x, :y, :z, :autocontinue]
      |> Enum.map(&{Atom.to_string(&1), Map.fetch!(a, &1), Map.fetch!(b, &1)})

    params = for n <- 0..3, do: {"param#{n + 1}", elem(a.params, n), elem(b.params, n)}
    Enum.find(names ++ params, fn {_name, sent, read} -> sent != read end)
  end
end
