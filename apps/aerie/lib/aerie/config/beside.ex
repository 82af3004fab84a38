defmodule Aerie.Config.Beside do
  @moduledoc """
  Files that a configuration file names: a relative name begins at the folder of that file, so that a file and its keys and
  certificates can be copied together. Pure.

  It concerns keys of type `:file`, which the gateway only reads. Its own folders (`:path`) begin at `AERIE_HOME`, and so does
  a name from the environment or the command line.
  """

  alias Aerie.Base.Settings.Field

  @doc "The tree of the file at `path`, with the whole names of its files. Other values are left for the checks."
  @spec expand(term(), [Field.t()], Path.t() | nil) :: term()
  def expand(raw, _fields, nil), do: raw
  def expand(raw, fields, path), do: value(raw, {:section, fields}, Path.dirname(Path.expand(path)))

  defp value(name, :file, folder) when is_binary(name) and name != "", do: Path.absname(name, folder)

  defp value(raw, {:section, fields}, folder) when is_map(raw) do
    for %Field{type: type} = field <- fields, is_map_key(raw, Field.name(field)), reduce: raw do
      raw -> Map.update!(raw, Field.name(field), &value(&1, type, folder))
    end
  end

  defp value(raw, {:list, type}, folder) when is_list(raw), do: Enum.map(raw, &value(&1, type, folder))
  defp value(raw, _type, _folder), do: raw
end
