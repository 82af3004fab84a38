defmodule Aerie.Api.Rest.Route do
  @moduledoc """
  One method of one path of `/api`: a row of `Aerie.Api.Rest.Routes`. Dispatch, the access check and `docs/openapi.json`
  all read it here.

  | field | meaning |
  |---|---|
  | `method`, `path` | as in `"GET"`, `"/api/links/:id"`; what `:name` stands for is a binding of the request |
  | `action` | the clause of `Aerie.Api.Rest.Actions.run/3` that answers |
  | `change` | what it changes of the gateway (`Aerie.Access.Changes.Rights`), for the audit log; nil for nothing |
  | `role` | the least role that may; a viewer may read everything |
  | `summary` | one line, for the description |
  | `body` | the name of a schema (`Aerie.Api.Rest.OpenAPI.Bodies`), `{:bytes, media types, name of the one as JSON}`, or nil for none |
  | `query` | names of parameters (`Aerie.Api.Rest.OpenAPI.Parameters`), or `{name, schema, meaning}` |
  | `status` | of the answer; with `later: true` also 202: the command goes on |
  | `answer` | names of schemas, nil for none (`status` is 204), or `{:bytes, media types, names of those as JSON}` |
  """

  alias Aerie.Access.Changes.Rights
  alias Aerie.Control.Policy.Roles

  @enforce_keys [:method, :path, :action, :role, :summary]
  defstruct [
    :method,
    :path,
    :action,
    :role,
    :summary,
    :change,
    :body,
    query: [],
    status: 200,
    later: false,
    answer: nil
  ]

  @type action :: atom() | tuple()
  @type body :: schema() | {:bytes, [String.t()], schema()} | nil
  @type schema :: atom() | String.t()
  @type t :: %__MODULE__{
          method: String.t(),
          path: String.t(),
          action: action(),
          change: Rights.change() | nil,
          role: Roles.role(),
          summary: String.t(),
          body: body(),
          query: [atom() | {:format, [String.t()]} | {atom() | String.t(), map(), String.t()}],
          status: 200..299,
          later: boolean(),
          answer: schema() | [schema()] | {:bytes, [String.t()], schema() | [schema()] | nil} | nil
        }

  @doc "A route that reads: open to every admitted requester."
  @spec get(String.t(), action(), String.t(), keyword()) :: t()
  def get(path, action, summary, options \\ []) do
    struct!(
      %__MODULE__{method: "GET", path: path, action: action, role: :viewer, summary: summary},
      options
    )
  end

  for method <- ~w(post put patch delete)a do
    @doc "A route that changes something, for those whom `Aerie.Access.Changes.Rights` allows it."
    @spec unquote(method)(String.t(), Rights.change(), String.t(), keyword()) :: t()
    def unquote(method)(path, change, summary, options \\ []) do
      method = unquote(method |> Atom.to_string() |> String.upcase())
      role = Rights.least(change)

      struct!(
        %__MODULE__{method: method, path: path, action: change, change: change, role: role, summary: summary},
        options
      )
    end
  end
end
