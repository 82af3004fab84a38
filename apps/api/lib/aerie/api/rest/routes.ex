defmodule Aerie.Api.Rest.Routes do
  @moduledoc """
  Every method of every path below `/api`: one table of `Aerie.Api.Rest.Route`, from which dispatch, the access check
  and `docs/openapi.json` (`Aerie.Api.Rest.OpenAPI`) come. A new one is an operation of
  `Aerie.Control.Operations`, or a row of `Routes.Gateway` or `Routes.Vehicle` and a clause of `Actions.run/3`.
  """

  alias Aerie.Access.HTTP.Error
  alias Aerie.Api.Rest.{Operations, Route}
  alias Aerie.Api.Rest.Routes.{Gateway, Vehicle}

  @typedoc "The path of a resource as it is in the table; `:missing` for one that is not there."
  @type resource :: String.t() | :missing

  @routes Gateway.rows() ++ Vehicle.rows() ++ Operations.routes()
  @grouped for path <- Enum.uniq(Enum.map(@routes, & &1.path)),
               do: {path, Enum.sort(for(%{path: ^path, method: method} <- @routes, do: method))}

  @doc "All routes, in the order of the table."
  @spec all() :: [Route.t()]
  def all, do: @routes

  @doc "The paths for Cowboy, each with its resource."
  @spec paths() :: [{String.t(), resource()}]
  def paths, do: for({path, _methods} <- @grouped, do: {path, path}) ++ [{"/api/[...]", :missing}]

  @doc "The methods of a resource; with GET also HEAD."
  @spec methods(resource()) :: [String.t()]
  def methods(resource) do
    methods = own(resource)
    if "GET" in methods, do: methods ++ ["HEAD"], else: methods
  end

  @doc "The route of a method on a resource. HEAD is GET; Cowboy leaves out the body."
  @spec find(resource(), String.t()) :: {:ok, Route.t()} | {:error, Error.t()}
  def find(:missing, _method), do: {:error, Error.new(:not_found, "there is no such resource; see /api")}
  def find(resource, "HEAD"), do: find(resource, "GET")

  def find(resource, method) do
    with nil <- Enum.find(@routes, &(&1.path == resource and &1.method == method)) do
      allowed = resource |> own() |> Enum.join(", ")
      {:error, Error.new(:method_not_allowed, "this resource takes #{allowed}", %{"allow" => allowed})}
    else
      route -> {:ok, route}
    end
  end

  @doc "The paths and which methods each takes, for `/api` itself."
  @spec index() :: [%{path: String.t(), methods: [String.t()]}]
  def index, do: for({path, methods} <- @grouped, do: %{path: path, methods: methods})

  defp own(resource), do: for({^resource, methods} <- @grouped, method <- methods, do: method)
end
