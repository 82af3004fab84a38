defmodule Aerie.Link.Clients.Settings do
  @moduledoc """
  From the keys of the configuration (`clients`, see `config/gateway.example.yaml`) to a client's connection and the rules of
  its endpoints (`Aerie.Router.Settings`).
  """

  alias Aerie.Link.Spec
  alias Aerie.Router.Owner
  alias Aerie.Router.Settings

  @doc """
  A client's connection: its keys are `:url` (required), `:id`, `:label`, `:networks` (all, also those that come later, when
  there are none), `:network` (the gateway's own, `main`) and those of the rules. The error is words.
  """
  @spec client(map) :: {:ok, Spec.t()} | {:error, String.t()}
  def client(%{url: url} = map) do
    networks = List.wrap(map[:networks])

    with {:ok, options} <-
           Settings.owner_options(map |> Map.put(:networks, networks) |> Map.put(:side, :client)),
         {:ok, spec} <- spec(url, map, List.first(networks) || map[:network] || "main", options),
         {:ok, _owner} <- Owner.new(spec.id, options) do
      {:ok, spec}
    end
  end

  def client(_other), do: {:error, "a client needs a url"}

  defp spec(url, map, network, options) do
    case Spec.parse(url, id: map[:id], network: network, options: [label: map[:label], router: options]) do
      {:ok, %{kind: :replay}} -> {:error, "a recording is no client: it is a link"}
      {:ok, spec} -> {:ok, spec}
      {:error, error} -> {:error, Exception.message(error)}
    end
  end
end
