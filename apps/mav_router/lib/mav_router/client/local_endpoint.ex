defmodule MavRouter.Client.LocalEndpoint do
  @moduledoc """
  Makes a process of this machine an endpoint (`MavRouter.Endpoints.Endpoint`): a socket's client, a page, a script.
  """

  alias Aerie.Base.Names
  alias MavRouter.Router
  alias MavRouter.Endpoints.Endpoint
  alias MavRouter.Endpoints
  alias MavRouter.Endpoints.Owner
  alias MavRouter.Tables
  alias MavRouter.Endpoints.Owner.SavedRules

  @doc """
  Makes the calling process an endpoint.

  Options: `:id` (of its owner; required, unique among links and clients), `:text` (who is at the other end, for people),
  `:kind` (an atom, for people: `:websocket`), `:principal` (who proved to be at the other end) and those of
  `MavRouter.Endpoints.Owner`, of which `:side` is `:client` by default.
  """
  @spec attach(Names.gateway(), keyword) :: {:ok, Endpoint.t()} | {:error, String.t() | :not_running}
  def attach(gateway, options) do
    {own, rules} = Keyword.split(options, [:id, :text, :kind, :principal])
    id = Keyword.fetch!(own, :id)

    with tables when is_map(tables) <- Tables.of(gateway),
         {:ok, owner} <- Owner.new(id, Keyword.put_new(rules, :side, :client)),
         owner = SavedRules.restore(gateway, owner),
         endpoint = Endpoint.new(gateway, {id, :self}, [out: {:pid, self(), nil}] ++ Keyword.delete(own, :id)),
         :ok <- Endpoints.attach(gateway, tables, owner, endpoint) do
      {:ok, endpoint}
    else
      nil -> {:error, :not_running}
      {:error, words} -> {:error, words}
    end
  end

  @doc "Delivers frames that came from the other end; see `MavRouter.Router.deliver/4`."
  @spec ingress(Endpoint.t(), [MavCodec.Frame.t()], Router.cache() | nil) ::
          {Router.outcome(), Router.cache() | nil}
  def ingress(%Endpoint{key: {owner, peer}} = endpoint, frames, cache \\ nil) do
    Router.deliver(endpoint.gateway, %{id: owner, network: nil, peer: peer}, frames, cache)
  end

  @doc "Ends an endpoint made by `attach/2`."
  @spec detach(Endpoint.t()) :: :ok
  def detach(%Endpoint{key: {owner, _peer}, gateway: gateway}) do
    with tables when is_map(tables) <- Tables.of(gateway), do: Endpoints.close(gateway, tables, owner)
    :ok
  end
end
