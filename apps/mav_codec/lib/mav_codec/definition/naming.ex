defmodule MavCodec.Definition.Naming do
  @moduledoc """
  How XML names become Elixir names.

  These atoms come from definition files at compile time only, never from data.
  """

  # As text, because a module alias would make this code depend on the modules that are compiled with it.
  @dialects "MavCodec.Dialects"
  @enums "MavCodec.Enums"

  @doc ~S|`"GLOBAL_POSITION_INT"` to `"GlobalPositionInt"`.|
  @spec camel(String.t()) :: String.t()
  def camel(name) do
    name
    |> String.downcase()
    |> String.split("_", trim: true)
    |> Enum.map_join(&String.capitalize/1)
  end

  @doc "The module of an official enum."
  @spec enum(String.t()) :: module()
  def enum(name), do: Module.concat(@enums, camel(name))

  @doc "The struct key of a field: its name in lower case."
  @spec key(String.t()) :: atom()
  def key(name), do: name |> String.downcase() |> String.to_atom()

  @doc "The module of a dialect that merges sources."
  @spec joined(String.t()) :: module()
  def joined(name), do: Module.concat(@dialects, name)

  @doc """
  The dialect module of a file of a source.

  Upstream's files are `MavCodec.Dialects.Common` and so on; those of another source lie under its name, such as
  `MavCodec.Dialects.Ardupilot.Common`. The source's whole (`all.xml`, or the file named like the source) is
  `MavCodec.Dialects.Upstream`, `MavCodec.Dialects.Ardupilot`.
  """
  @spec dialect(String.t(), String.t()) :: module()
  def dialect(source, file) do
    base = Path.basename(file, ".xml")

    cond do
      base in ["all", source] -> Module.concat(@dialects, Macro.camelize(source))
      source == "upstream" -> Module.concat(@dialects, Macro.camelize(base))
      true -> Module.concat([@dialects, Macro.camelize(source), Macro.camelize(base)])
    end
  end

  @doc """
  The name of a dialect in configurations: `"common"`, `"ardupilot/common"`; a source's whole has the source's name.
  """
  @spec dialect_name(String.t(), String.t()) :: String.t()
  def dialect_name(source, file) do
    base = Path.basename(file, ".xml")

    cond do
      base in ["all", source] -> source
      source == "upstream" -> base
      true -> source <> "/" <> base
    end
  end

  @doc "The labels of an enum's entries: their names without the common prefix."
  @spec labels(String.t(), [String.t()]) :: [String.t()]
  def labels(enum, names) do
    prefix = enum <> "_"

    cut =
      if Enum.all?(names, &String.starts_with?(&1, prefix)),
        do: byte_size(prefix),
        else: names |> common_prefix() |> byte_size()

    Enum.map(names, &binary_part(&1, cut, byte_size(&1) - cut))
  end

  # The prefix ends with a _ and is never a whole name.
  defp common_prefix(names) do
    case :binary.longest_common_prefix(names) do
      0 ->
        ""

      size ->
        case names |> hd() |> binary_part(0, size) |> :binary.matches("_") do
          [] -> ""
          matches -> names |> hd() |> binary_part(0, longest(matches, names))
        end
    end
  end

  defp longest(matches, names) do
    shortest = names |> Enum.map(&byte_size/1) |> Enum.min()
    matches |> Enum.map(fn {at, 1} -> at + 1 end) |> Enum.filter(&(&1 < shortest)) |> Enum.max(fn -> 0 end)
  end
end
