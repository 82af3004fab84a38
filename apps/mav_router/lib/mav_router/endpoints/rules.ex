defmodule MavRouter.Endpoints.Rules do
  @moduledoc """
  Rules of links and clients that are changed while these run (`MavRouter.Router.configure/3`): checked, remembered by `Aerie.Base.Store`,
  listed and undone.

  The changes are remembered, not their result: after a restart of the link's process or of the router they are applied to the
  configuration (`configured` of an owner) once more. They are forgotten with the link or client, by `reset/3`, and with the gateway.
  """

  alias Aerie.Base.Error
  alias Aerie.Base.Store
  alias Aerie.Base.Names
  alias MavRouter.Endpoints
  alias MavRouter.Endpoints.{Owner, RuleChanges}
  alias MavRouter.Endpoints.Owner.SavedRules
  alias MavRouter.Endpoints.Owner.RuleKeys
  alias MavRouter.Tables

  @typedoc "What holds now, by key of the configuration; nil for no rule."
  @type changes :: %{atom => term}

  @doc "Changes rules; the others stay. After an error nothing was changed."
  @spec change(Names.gateway(), String.t(), map | keyword) :: :ok | {:error, Error.t()}
  def change(gateway, id, changes) do
    with {:ok, changes} <- known(Map.new(changes)),
         {:ok, tables, owner} <- owner(gateway, id),
         :ok <- networks(tables, owner, changes[:networks]),
         :ok <- carriers(tables, changes[:carry] || %{}) do
      put(gateway, tables, owner, Map.merge(SavedRules.changes(gateway, id), changes))
    end
  end

  @doc "The schema of what `write/3` takes."
  @spec schema() :: RuleChanges.t()
  defdelegate schema, to: RuleChanges

  @doc "Changes rules as a program writes them, by the keys of the configuration."
  @spec write(Names.gateway(), String.t(), map) :: :ok | {:error, Error.t() | {:invalid, String.t()}}
  def write(gateway, id, object) do
    case RuleChanges.parse(object) do
      {:ok, changes} -> change(gateway, id, changes)
      {:error, words} -> {:error, {:invalid, words}}
    end
  end

  @doc "Undoes changes: of these keys, or all."
  @spec reset(Names.gateway(), String.t(), [atom] | :all) :: :ok | {:error, Error.t()}
  def reset(gateway, id, keys \\ :all) do
    with {:ok, tables, owner} <- owner(gateway, id) do
      put(
        gateway,
        tables,
        owner,
        if(keys == :all, do: %{}, else: Map.drop(SavedRules.changes(gateway, id), keys))
      )
    end
  end

  @doc """
  What differs from the configuration: `%{id => %{key => %{now: value, configured: value}}}`, with nil for no rule.
  """
  @spec list(Names.gateway()) :: %{String.t() => %{atom => %{now: term, configured: term}}}
  def list(gateway) do
    for {{:rules, id}, changes} <- Store.remembered(gateway),
        {:ok, _tables, owner} <- [owner(gateway, id)],
        differing = differing(owner, changes),
        differing != %{},
        into: %{},
        do: {id, differing}
  end

  defp differing(owner, changes) do
    changes
    |> Map.new(fn {key, value} ->
      {key, %{now: if(RuleKeys.empty?(value), do: nil, else: value), configured: configured(owner, key)}}
    end)
    |> Map.reject(fn {_key, %{now: now, configured: configured}} -> now == configured end)
  end

  # Owners keep options; the configuration has another form.
  defp configured(owner, key), do: RuleKeys.key(key, owner.configured)

  defp put(gateway, tables, owner, changes) do
    with {:ok, owner} <- SavedRules.apply_to(owner, changes) do
      if changes == %{},
        do: Store.forget(gateway, {:rules, owner.id}),
        else: Store.remember(gateway, {:rules, owner.id}, changes)

      Endpoints.put_owner(tables, owner)
      with pid when is_pid(pid) <- Names.whereis(gateway, :link, owner.id), do: send(pid, {:rules, owner})
      :ok
    end
  end

  defp known(changes) do
    case Map.keys(changes) -- RuleKeys.changeable() do
      [] -> {:ok, changes}
      [key | _] -> Error.new({:invalid, "#{inspect(key)} is not a rule that can be changed at run time"})
    end
  end

  # A link may be the first of a network. A client of one that does not exist would get nothing.
  # Shapes are checked by `SavedRules.apply_to/2`.
  defp networks(tables, %Owner{side: :client}, [_ | _] = names),
    do: if(Enum.all?(names, &is_binary/1), do: Endpoints.known_networks(tables, names), else: :ok)

  defp networks(_tables, _owner, _names), do: :ok

  defp carriers(tables, %{} = carry) do
    case Enum.find(Map.values(carry), &(is_binary(&1) and &1 != "all" and Endpoints.owner(tables, &1) == nil)) do
      nil -> :ok
      stray -> Error.new({:invalid, "carry: unknown link #{inspect(String.slice(stray, 0, 64))}"})
    end
  end

  defp carriers(_tables, _wrong), do: :ok

  defp owner(gateway, id) do
    with tables when is_map(tables) <- Tables.of(gateway), %Owner{} = owner <- Endpoints.owner(tables, id) do
      {:ok, tables, owner}
    else
      nil -> Error.new({:unknown, :owner, id})
    end
  end
end
