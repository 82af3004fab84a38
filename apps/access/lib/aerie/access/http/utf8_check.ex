defmodule Aerie.Access.HTTP.Utf8Check do
  @moduledoc """
  A middleware that answers requests whose path, query or used headers are not UTF-8 with 400, before anything else reads them.
  So nobody has to check: an answer or a log that repeated such bytes could not be encoded.
  """

  @behaviour :cowboy_middleware

  alias Aerie.Base.Store
  alias Aerie.Access.HTTP.Error

  @read ~w(host origin x-aerie-key authorization content-type upgrade sec-websocket-protocol x-forwarded-for x-forwarded-proto)

  @doc "Cowboy's middlewares, with this one first."
  @spec middlewares() :: [module()]
  def middlewares, do: [__MODULE__, :cowboy_router, :cowboy_handler]

  @impl :cowboy_middleware
  def execute(request, env) do
    case check(:cowboy_req.path(request), :cowboy_req.qs(request), :cowboy_req.headers(request)) do
      :ok ->
        {:ok, request, env}

      {:error, error} ->
        Store.count_if_running(env.gateway, {:api, error.status})
        {:stop, Error.refuse(error, request)}
    end
  end

  defp check(path, query, headers) do
    cond do
      not text?(path) -> refuse("the path is not percent-encoded UTF-8")
      not text?(query) -> refuse("the query is not percent-encoded UTF-8")
      name = Enum.find(@read, &(not String.valid?(Map.get(headers, &1, "")))) -> refuse("#{name} is not text")
      true -> :ok
    end
  end

  defp refuse(words), do: {:error, Error.new(:bad_request, words)}

  defp text?(encoded), do: encoded |> URI.decode() |> String.valid?()
end
