defmodule MavRouter.Endpoints.Owner.SavedRules do
  @moduledoc """
  The changes of rules that `Aerie.Base.Store` remembers for `MavRouter.Endpoints.Rules`, and an owner with them.
  """

  alias Aerie.Base.{Error, Names, Store}
  alias MavRouter.Endpoints.Owner
  alias MavRouter.Endpoints.Owner.RuleKeys

  @doc "An owner as configured, with its remembered changes."
  @spec restore(Names.gateway(), Owner.t()) :: Owner.t()
  def restore(gateway, owner) do
    case apply_to(owner, changes(gateway, owner.id)) do
      {:ok, owner} -> owner
      # The configuration was changed meanwhile, and the remembered change does not fit any more.
      {:error, _error} -> owner
    end
  end

  @doc "Forgets the changes of an owner that is gone."
  @spec forget(Names.gateway(), String.t()) :: :ok
  def forget(gateway, id) do
    # Nearly always there are none; and at the very end there may be no store.
    if changes(gateway, id) == %{}, do: :ok, else: Store.forget(gateway, {:rules, id})
  end

  @doc "The remembered changes of an owner."
  @spec changes(Names.gateway(), String.t()) :: %{atom => term}
  def changes(gateway, id), do: Store.recall(gateway, {:rules, id}, %{})

  @doc "An owner as configured, with these changes."
  @spec apply_to(Owner.t(), %{atom => term}) :: {:ok, Owner.t()} | {:error, Error.t()}
  def apply_to(owner, changes) do
    gone = for {key, value} <- changes, RuleKeys.empty?(value), do: RuleKeys.option(key)

    with {:ok, options} <- RuleKeys.owner_options(changes),
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
end
