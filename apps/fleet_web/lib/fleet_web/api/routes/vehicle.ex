defmodule FleetWeb.API.Routes.Vehicle do
  @moduledoc "The routes of one vehicle: commands, desired state, parameters, plans, files, logs (`FleetWeb.API.Routes`)."

  import FleetWeb.API.Route

  alias FleetWeb.API.Transfers

  @bytes {:bytes, ["application/octet-stream"]}
  @params_text {:bytes, ["application/json", "text/plain"]}
  @plan {:bytes, ["application/json", "text/plain", "application/octet-stream"]}
  @params_format {:format, ~w(json param params txt)}
  @plans [mission: "mission", fence: "fence", rally: "rally points"]

  @doc "The rows."
  @spec rows() :: [FleetWeb.API.Route.t()]
  def rows do
    [
      get("/api/vehicles/:id", :vehicle, "Everything that is known of a vehicle."),
      get("/api/vehicles/:id/events", :vehicle_events, "The latest events of a vehicle.",
        query: [:limit, :since]
      ),
      post("/api/vehicles/:id/save", :save, :operator, "Saves the last minutes of a vehicle as a recording.",
        body: :save,
        status: 201
      ),
      put("/api/vehicles/:id/recording", :record_vehicle, :admin, "Starts or stops recording a vehicle.",
        body: :mode
      ),
      get("/api/vehicles/:id/signing", :vehicle_signing, "The signing state of a vehicle."),
      post(
        "/api/vehicles/:id/signing",
        :sign_vehicle,
        :admin,
        "Gives a vehicle a signing key, or takes it away.",
        body: :signing
      ),
      get(
        "/api/vehicles/:id/commands",
        :vehicle_commands,
        "Which commands this key may give to the vehicle."
      ),
      post("/api/vehicles/:id/commands", :command, :operator, "Gives a command, and waits for its result.",
        query: [:wait],
        body: :command,
        later: true
      ),
      get(
        "/api/vehicles/:id/commands/:command",
        :look_at_command,
        "The progress of a command, or its result."
      ),
      delete("/api/vehicles/:id/commands/:command", :cancel_command, :operator, "Cancels a command.",
        status: 202
      ),
      get(
        "/api/vehicles/:id/shadow",
        :shadow,
        "What is desired of a vehicle, what is reported, and how they differ."
      ),
      patch("/api/vehicles/:id/shadow", :update_shadow, :operator, "Changes the desired state.",
        body: :shadow
      ),
      delete("/api/vehicles/:id/shadow", :delete_shadow, :operator, "Clears the desired state.",
        query: [:version]
      ),
      get("/api/vehicles/:id/shadow/delta", :shadow_delta, "What is desired but not yet so."),
      get("/api/vehicles/:id/params", {:transfer, :list_params}, "All parameters of a vehicle.",
        query: [@params_format, :component, :timeout],
        answer: @params_text
      ),
      put(
        "/api/vehicles/:id/params",
        {:transfer, :load_params},
        :operator,
        "Sets several parameters of a vehicle.",
        query: [@params_format, :timeout, :wait, :id, :unknown],
        body: {:bytes, ["application/json", "text/plain"], :params},
        later: true
      ),
      get("/api/vehicles/:id/params/:name", {:transfer, :get_param}, "One parameter.",
        query: [:component, :timeout]
      ),
      put("/api/vehicles/:id/params/:name", {:transfer, :set_param}, :operator, "Sets a parameter.",
        query: [:component, :timeout, :wait, :id],
        body: :param,
        later: true
      ),
      get(
        "/api/vehicles/:id/metadata/params",
        {:transfer, :param_metadata},
        "What the vehicle itself says of its parameters.",
        query: [:timeout]
      ),
      get(
        "/api/vehicles/:id/files/[...]",
        {:transfer, :read_file},
        "A file on board; with list, a folder; with crc, its checksum.",
        query: [:timeout, :list, :crc],
        answer: @bytes
      ),
      put("/api/vehicles/:id/files/[...]", {:transfer, :write_file}, :operator, "Writes a file on board.",
        query: [:timeout, :wait, :id],
        body: {:bytes, ["application/octet-stream"], :object},
        later: true
      ),
      delete(
        "/api/vehicles/:id/files/[...]",
        {:transfer, :remove_file},
        :operator,
        "Removes a file on board.",
        query: [:timeout, :wait, :id],
        later: true
      ),
      get("/api/vehicles/:id/logs", {:transfer, :list_logs}, "The logs on board.", query: [:timeout]),
      get("/api/vehicles/:id/logs/:log", {:transfer, :download_log}, "A log on board.",
        query: [:timeout],
        answer: @bytes
      )
    ] ++ Enum.flat_map(@plans, &plan/1)
  end

  defp plan({kind, name}) do
    path = "/api/vehicles/:id/#{kind}"
    format = {:format, Transfers.formats(kind)}

    [
      get(path, {:transfer, {:get_plan, kind}}, "Reads the #{name} of a vehicle.",
        query: [format, :timeout],
        answer: @plan
      ),
      put(path, {:transfer, {:put_plan, kind}}, :operator, "Writes the #{name} of a vehicle.",
        query: [format, :timeout, :wait, :id, :force],
        body: {:bytes, ["application/json", "text/plain", "application/octet-stream"], :upload},
        later: true
      ),
      delete(path, {:transfer, {:clear_plan, kind}}, :operator, "Clears the #{name} of a vehicle.",
        query: [:timeout, :wait, :id],
        later: true
      )
    ]
  end
end
