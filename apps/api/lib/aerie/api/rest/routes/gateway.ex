defmodule Aerie.Api.Rest.Routes.Gateway do
  @moduledoc """
  The routes of the gateway: links, clients, rules, recordings, policy, configuration, operations
  (`Aerie.Api.Rest.Routes`).
  """

  import Aerie.Api.Rest.Route

  @bytes {:bytes, ["application/json", "application/octet-stream"], :object}
  @plan {:bytes, ["application/json", "text/plain", "application/octet-stream"], :plan}

  @doc "The rows."
  @spec rows() :: [Aerie.Api.Rest.Route.t()]
  def rows do
    [
      get("/api", :index, "The resources and their methods."),
      get("/api/openapi", :openapi, "This description."),
      get("/api/status", :status, "The most used state of all vehicles."),
      get("/api/diagnosis", :diagnosis, "What is wrong, and what to do about it."),
      get("/api/vehicles", :vehicles, "All vehicles.", query: [:tag]),
      get("/api/events", :events, "The latest events of all vehicles.", query: [:limit, :since]),
      get("/api/signing", :signing, "Signed links and vehicles."),
      get(
        "/api/signing/capability",
        :signing_capability,
        "Which vehicles can sign, and by which links they can be given a key."
      ),
      get("/api/links", :links, "All links."),
      delete("/api/links/:id", :remove_link, "Closes and forgets a link.", status: 204, answer: nil),
      get("/api/recorder", :recorder, "What is being recorded, and the recordings on disk."),
      get("/api/recordings/:name", :download, "A recording.", answer: @bytes),
      get("/api/clients", :clients, "Endpoints for clients, and the clients that are connected."),
      delete("/api/clients/:id", :remove_client, "Removes an endpoint, or disconnects a client.",
        status: 204,
        answer: nil
      ),
      get("/api/rules", :rules, "The routing rules of links and clients."),
      patch("/api/rules/:id", :change_rules, "Changes the rules of a link or client.", body: :rules),
      delete("/api/rules/:id", :reset_rules, "Restores the configured rules.",
        status: 204,
        answer: nil
      ),
      post(
        "/api/config/reload",
        :reload_config,
        "Reads the configuration again and puts in force what can change without a restart.",
        body: :nothing
      ),
      get("/api/log", :log, "The levels of the log."),
      get("/api/policy", :policy, "The policy in force."),
      post("/api/policy/reload", :reload_policy, "Reads the policy and its fences again.", body: :nothing),
      post("/api/plans", :store_plan, "Stores a .plan file for desired states.",
        body: @plan,
        status: 201
      ),
      get("/api/commands/types", :command_types, "The commands with their parameters."),
      post("/api/tickets", :issue_ticket, "Issues a ticket that opens one WebSocket.",
        body: :nothing,
        status: 201
      )
    ]
  end
end
