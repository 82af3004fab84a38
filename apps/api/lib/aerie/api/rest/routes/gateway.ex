defmodule Aerie.Api.Rest.Routes.Gateway do
  @moduledoc """
  The routes of the gateway: links, clients, rules, recordings, policy, configuration, operations
  (`Aerie.Api.Rest.Routes`).
  """

  import Aerie.Api.Rest.Route

  @bytes {:bytes, ["application/octet-stream"], nil}

  @doc "The rows."
  @spec rows() :: [Aerie.Api.Rest.Route.t()]
  def rows do
    [
      get("/api", :index, "The resources and their methods.", answer: :index),
      get("/api/openapi", :openapi, "This description.", answer: :openapi),
      get("/api/status", :status, "The most used state of all vehicles.", answer: :status),
      get("/api/diagnosis", :diagnosis, "What is wrong, and what to do about it.", answer: :diagnosis),
      get("/api/vehicles", :vehicles, "All vehicles.", query: [:tag], answer: :vehicles),
      get(
        "/api/signing/capability",
        :signing_capability,
        "Which vehicles can sign, and by which links they can be given a key.",
        answer: :signing_capability
      ),
      get("/api/recorder", :recorder, "What is being recorded, and the recordings on disk.",
        answer: :recorder
      ),
      get("/api/recordings/:name", :download, "A recording.", answer: @bytes),
      post(
        "/api/config/reload",
        :reload_config,
        "Reads the configuration again and puts in force what can change without a restart.",
        body: :nothing,
        answer: :reloaded
      ),
      get("/api/policy", :policy, "The policy in force.", answer: :policy),
      post("/api/policy/reload", :reload_policy, "Reads the policy and its fences again.",
        body: :nothing,
        answer: :policy
      ),
      post("/api/tickets", :issue_ticket, "Issues a ticket that opens one WebSocket.",
        body: :nothing,
        status: 201,
        answer: :ticket
      )
    ]
  end
end
