defmodule MavRouter.Router.Rules do
  @moduledoc """
  Rules of links and clients that are changed while these run (`MavRouter.Router.configure/3`): checked, remembered by `Aerie.Base.Store`,
  listed and undone.

  The changes are remembered, not their result: after a restart of the link's process or of the router they are applied to the
  configuration (`configured` of an owner) once more. They are forgotten with the link or client, by `reset/3`, and with the gateway.
  """

  alias Aerie.Base.Error
  alias Aerie.Base.Store
  alias Aerie.Base.Names
  alias MavRouter.Router.Endpoints
  alias MavRouter.Router.Owner
  alias MavRouter.Router.Settings
  alias MavRouter.Router.Tables

  @typedoc "What holds now, by key of the configuration; nil for no rule."
  @type changes :: %{atom => term}

  @doc "An owner as configured, with its remembered changes."
  @spec restore(Names.gateway(), Owner.t()) :: Owner.t()
  def restore(gateway, owner) do
    case apply_to(owner, changes(gateway, owner.id)) do
      {:ok, owner} -> owner
      # The configuration was changed meanwhile, and the remembered change does not fit any more.
      {:error, _error} -> owner
    end
  end

  @doc "Changes rules; the others stay. After an error nothing was changed."
  @spec change(Names.gateway(), String.t(), map | keyword) :: :ok | {:error, Error.t()}
  def change(gateway, id, changes) do
    with {:ok, changes} <- known(Map.new(changes)),
         {:ok, tables, owner} <- owner(gateway, id) do
      put(gateway, tables, owner, Map.merge(changes(gateway, id), changes))
    end
  end

  @doc "Undoes changes: of these keys, or all."
  @spec reset(Names.gateway(), String.t(), [atom] | :all) :: :ok | {:error, Error.t()}
  def reset(gateway, id, keys \\ :all) do
    with {:ok, tables, owner} <- owner(gateway, id) do
      put(gateway, tables, owner, if(keys == :all, do: %{}, else: Map.drop(changes(gateway, id), keys)))
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
      {key, %{now: if(Settings.empty?(value), do: nil, else: value), configured: configured(owner, key)}}
    end)
    |> Map.reject(fn {_key, %{now: now, configured: configured}} -> now == configured end)
  end

  # Owners keep options; the configuration has another form.
  defp configured(owner, key), do: Settings.key(key, owner.configured)

  @doc "Forgets the changes of an owner that is gone."
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
    else
      {:error, text} -> Error.new({:invalid, text})
    end
  end

  # Several keys of the configuration make one option.
  defp merged(:queue, configured, changed), do: Keyword.merge(configured, changed)
  defp merged(_key, _configured, changed), do: changed

  defp changes(gateway, id), do: Store.recall(gateway, {:rules, id}, %{})

  defp known(changes) do
    case Map.keys(changes) -- Settings.changeable() do
      [] -> {:ok, changes}
      [key | _] -> Error.new({:invalid, "#{inspect(key)} is not a rule that can be changed at run time"})
    end
  end

  defp owner(gateway, id) do
    with tables when is_map(tables) <- Tables.of(gateway), %Owner{} = owner <- Endpoints.owner(tables, id) do
      {:ok, tables, owner}
    else
      nil -> Error.new({:unknown, :owner, id})
    end
  end
end
