defmodule Aerie.Router.Rules do
  @moduledoc """
  Rules of links and clients that were changed while they run (`Aerie.Router.configure/3`): checked, remembered by
  `Aerie.Store`, listed and undone.

  What is remembered are the changes, not their result: a process of the link that is started again, or a restart of the
  router, begins with what the configuration says (`configured` of an owner) and applies them once more. They are
  forgotten with the link or client, by `reset/3`, and with the gateway.
  """

  alias Aerie.Store
  alias Aerie.Names
  alias Aerie.Router.Endpoints
  alias Aerie.Router.Owner
  alias Aerie.Router.Settings
  alias Aerie.Router.Tables

  @typedoc "By key of the configuration: what holds now, nil for nothing."
  @type changes :: %{atom => term}

  @doc "An owner as it is configured, with the changes that are remembered for it."
  @spec restore(Names.gateway(), Owner.t()) :: Owner.t()
  def restore(gateway, owner) do
    case apply_to(owner, changes(gateway, owner.id)) do
      {:ok, owner} -> owner
      # It is configured otherwise than it was, and the change does not fit any more.
      {:error, _words} -> owner
    end
  end

  @doc "Changes rules; those that are not named stay. The error is words, and nothing was changed then."
  @spec change(Names.gateway(), String.t(), map | keyword) :: :ok | {:error, String.t()}
  def change(gateway, id, changes) do
    with {:ok, changes} <- known(Map.new(changes)),
         {:ok, tables, owner} <- owner(gateway, id) do
      put(gateway, tables, owner, Map.merge(changes(gateway, id), changes))
    end
  end

  @doc "Undoes changes: of these keys, or all."
  @spec reset(Names.gateway(), String.t(), [atom] | :all) :: :ok | {:error, String.t()}
  def reset(gateway, id, keys \\ :all) do
    with {:ok, tables, owner} <- owner(gateway, id) do
      put(gateway, tables, owner, if(keys == :all, do: %{}, else: Map.drop(changes(gateway, id), keys)))
    end
  end

  @doc """
  What differs from the configuration: `%{id => %{key => %{now: value, configured: value}}}`, with nil for a rule that is
  not there.
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
      {key, %{now: if(Settings.empty?(value), do: nil, else: value), configured: configured(owner, key)}}
    end)
    |> Map.reject(fn {_key, %{now: now, configured: configured}} -> now == configured end)
  end

  # Options are kept in the form of the router; a key of the configuration is given back in its own.
  defp configured(owner, key), do: Settings.key(key, owner.configured)

  @doc "Forgets the changes of an owner that is no more."
  @spec forget(Names.gateway(), String.t()) :: :ok
  def forget(gateway, id) do
    # Nearly always there are none; and at the very end there may be no store.
    if changes(gateway, id) == %{}, do: :ok, else: Store.forget(gateway, {:rules, id})
  end

  defp put(gateway, tables, owner, changes) do
    with {:ok, owner} <- apply_to(owner, changes) do
      if changes == %{},
        do: Store.forget(gateway, {:rules, owner.id}),
        else: Store.remember(gateway, {:rules, owner.id}, changes)

      Endpoints.put_owner(tables, owner)
      with pid when is_pid(pid) <- Names.whereis(gateway, :link, owner.id), do: send(pid, {:rules, owner})
      :ok
    end
  end

  defp apply_to(owner, changes) do
    gone = for {key, value} <- changes, Settings.empty?(value), do: Settings.option(key)

    with {:ok, options} <- Settings.owner_options(changes),
         options = owner.configured |> Keyword.drop(gone) |> Keyword.merge(options, &merged/3),
         {:ok, changed} <- Owner.new(owner.id, options) do
      {:ok, %{changed | configured: owner.configured}}
    end
  end

  # Two keys of the configuration make one option.
  defp merged(:queue, configured, changed), do: Keyword.merge(configured, changed)
  defp merged(_key, _configured, changed), do: changed

  defp changes(gateway, id), do: Store.recall(gateway, {:rules, id}, %{})

  defp known(changes) do
    case Map.keys(changes) -- Settings.changeable() do
      [] -> {:ok, changes}
      [key | _] -> {:error, "#{inspect(key)} is no rule that can be changed while it runs"}
    end
  end

  defp owner(gateway, id) do
    with tables when is_map(tables) <- Tables.of(gateway), %Owner{} = owner <- Endpoints.owner(tables, id) do
      {:ok, tables, owner}
    else
      nil -> {:error, "there is no link and no client #{id}"}
    end
  end
end
