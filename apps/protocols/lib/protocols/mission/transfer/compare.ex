defmodule Protocols.Mission.Transfer.Compare do
  @moduledoc """
  Compares the plan that was read back with the one that was sent (W8), by what the firmware keeps of it (`c:Protocols.Mission.Firmware.kept/3`), without
  `current`. What the firmware does not keep is a remark if it was sent; everything else that differs is a difference. What comes back as it
  was sent is right whatever is known of the firmware: a later version may keep more.
  """

  alias Protocols.Mission.{Item, StoredItem}

  @mission 0
  @max_remarks 20

  @typedoc "A sentence on what the firmware does not keep."
  @type remark :: String.t()
  @type t :: {:same, [remark()]} | {:differs, non_neg_integer(), String.t()}

  @doc """
  `{:same, remarks}`, or the number of the first item that differs, and how. `kind` is that of the
  vehicle.
  """
  @spec plans([Item.t()], [Item.t()], 0..2, module(), kind :: String.t()) :: t()
  def plans(sent, read, type, protocol, kind) do
    # The vehicle sets home when it is armed, whatever was sent; a cleared mission may keep it.
    first = if type == @mission and protocol.home_is_item_0?(), do: 1, else: 0
    {sent, read} = {Enum.drop(sent, first), Enum.drop(read, first)}

    compared =
      sent
      |> Enum.zip(read)
      |> Enum.with_index(first)
      |> Enum.reduce_while([], fn {{a, b}, seq}, remarks ->
        case item(compared(a, type), compared(b, type), seq, protocol.kept(a, type, kind)) do
          {:differs, _seq, _how} = difference -> {:halt, difference}
          more -> {:cont, Enum.reverse(more, remarks)}
        end
      end)

    cond do
      is_tuple(compared) -> compared
      length(sent) == length(read) -> {:same, compared |> Enum.reverse() |> bounded()}
      true -> shorter(length(sent) + first, length(read) + first)
    end
  end

  defp shorter(sent, read),
    do: {:differs, min(sent, read), "the vehicle has #{read} items and not #{sent}"}

  defp bounded(remarks) do
    case Enum.split(remarks, @max_remarks) do
      {remarks, []} -> remarks
      {remarks, more} -> remarks ++ ["and #{length(more)} more"]
    end
  end

  # Only a mission has a next item.
  defp compared(item, @mission), do: item
  defp compared(item, _fence_or_rally), do: %{item | autocontinue: 1}

  defp item(sent, read, seq, kept) do
    fields = for {{name, a}, {name, b}} <- Enum.zip(fields(sent), fields(read)), do: {name, a, b}

    case Enum.find(fields, fn {name, a, b} -> not right?(kept[name], a, b) end) do
      nil ->
        for {name, a, b} <- fields,
            not StoredItem.same?(Map.get(kept, name, [a]), a, b),
            do: "item #{seq}: the vehicle keeps #{name} #{format(b)} and not #{format(a)}"

      {name, a, b} ->
        {:differs, seq, "item #{seq} has #{name} #{format(b)} and not #{format(a)}"}
    end
  end

  defp right?(nil, a, b), do: StoredItem.match?([a], b)
  defp right?(expected, a, b), do: StoredItem.match?([a], b) or StoredItem.match?(expected, b)

  # 20.119998931884766 m are 2012 cm.
  defp format(value) when is_float(value) and abs(value) < 1.0e6,
    do: value |> Float.round(4) |> Aerie.Base.Json.encode!()

  defp format(nil), do: "unset"
  defp format(value), do: "#{value}"

  defp fields(item) do
    %{params: {p1, p2, p3, p4}} = item = Item.rounded(item)

    [
      command: item.command,
      frame: Item.plain_frame(item.frame),
      x: item.x,
      y: item.y,
      z: item.z,
      autocontinue: item.autocontinue,
      param1: p1,
      param2: p2,
      param3: p3,
      param4: p4
    ]
  end
end
