defmodule Aerie.Control.Params.File.Diff do
  @moduledoc "The differences between two lists of parameters, or between a file and a list."

  alias Aerie.Control.Params.{File, Table}
  alias MavCodec.Message.ParamValue

  @typedoc """
  Names in their order: `changed` with both values, `only_left` and `only_right` with the value there.
  """
  @type t :: %{
          changed: [{String.t(), left :: number() | nil, right :: number() | nil}],
          only_left: [{String.t(), number()}],
          only_right: [{String.t(), number()}]
        }

  @doc "Compares; the left side may be the entries of a file. Values that are the same for a vehicle are equal."
  @spec diff(Table.t() | [File.entry()], Table.t()) :: t()
  def diff(left, right) do
    left = by_name(left)
    right = by_name(right)

    %{
      changed:
        for {name, one} <- left, other = right[name], not same?(one, other) do
          {name, one.value, other.value}
        end
        |> Enum.sort(),
      only_left: only(left, right),
      only_right: only(right, left)
    }
  end

  defp by_name(%Table{params: params}), do: params
  defp by_name(entries), do: Map.new(entries, &{&1.name, &1})

  defp same?(%{decimals: _digits} = entry, param), do: File.says?(entry, param.value)
  defp same?(one, other), do: ParamValue.same?(one.value, other.value)

  defp only(these, those),
    do: Enum.sort(for {name, %{value: value}} <- these, not is_map_key(those, name), do: {name, value})
end
