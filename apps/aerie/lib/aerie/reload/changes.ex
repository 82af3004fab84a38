defmodule Aerie.Reload.Changes do
  @moduledoc """
  What differs between two configurations: links and clients by their ids, the parts that can take new settings while they run, and the
  keys that count from the next start on. Pure.
  """

  alias Aerie.Base.Secret
  alias Aerie.Config
  alias Aerie.Config.Keys
  alias Aerie.Base.Settings.Schema

  @typedoc "`changed`: the new one of the same id."
  @type entries :: %{added: [map()], removed: [map()], changed: [map()]}
  @type t :: %{links: entries(), clients: entries(), log?: boolean(), restart: [String.t()]}

  # Each of these is taken over by its part. The policy is always read again, because its files may have changed.
  @live ["links", "clients", "policy", "log"]

  @doc "The differences from the old to the new configuration."
  @spec between(Config.t(), Config.t()) :: t()
  def between(old, new) do
    %{
      links: entries(old.links, new.links),
      clients: entries(clients(old), clients(new)),
      log?: old.log != new.log,
      restart: restart(old, new)
    }
  end

  @doc "The configuration of the start with what is in force of a later one."
  @spec in_force(Config.t(), Config.t()) :: Config.t()
  def in_force(start, later) do
    live? = fn {path, _source} -> hd(String.split(path, ".")) in @live end
    given = Map.merge(Map.reject(start.given, live?), Map.filter(later.given, live?))
    live = Map.take(later, Enum.map(@live, &String.to_existing_atom/1))
    start |> Map.merge(live) |> Map.put(:given, given)
  end

  # A closed interface counts as absent.
  defp entries(old, new) do
    old = by_id(old)
    new = by_id(new)

    %{
      removed: for({id, entry} <- old, not is_map_key(new, id), do: entry),
      added: for({id, entry} <- new, not is_map_key(old, id), do: entry),
      changed: for({id, entry} <- new, former = old[id], plain(former) != plain(entry), do: entry)
    }
  end

  defp by_id(entries),
    do: for(%{id: id} = entry <- entries, entry[:enabled] != false, into: %{}, do: {id, entry})

  # The source of a value (file, environment) does not count as a difference.
  defp plain(entry), do: Map.drop(entry, [:given])

  # The one that there is without any stays.
  defp clients(%{clients: :default}), do: []
  defp clients(%{clients: clients}), do: clients

  defp restart(old, new) do
    changed =
      for {[section | _] = path, _field} <- Schema.leaves(Keys.fields()),
          section not in @live,
          value(old, path) != value(new, path),
          do: Enum.join(path, ".")

    # From the default client to none or others, or back.
    if old.clients == :default != (new.clients == :default), do: ["clients" | changed], else: changed
  end

  defp value(config, path), do: Enum.reduce(path, config, &at/2)

  defp at(_key, nil), do: nil
  defp at(key, struct) when is_struct(struct), do: at(key, Map.from_struct(struct))

  defp at(key, %{} = map) do
    with {value} <- Enum.find_value(map, fn {name, value} -> if to_string(name) == key, do: {value} end),
         do: if(is_struct(value, Secret), do: Secret.reveal(value), else: value)
  end

  defp at(_key, _other), do: nil
end
