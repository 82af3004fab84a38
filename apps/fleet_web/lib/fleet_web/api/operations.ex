defmodule FleetWeb.API.Operations do
  @moduledoc """
  What each action of `FleetWeb.API.Resources` is for, takes and answers, for `docs/openapi.json` (`FleetWeb.API.OpenAPI`).

  | key | meaning |
  |---|---|
  | `summary` | one line |
  | `body` | the request's body: the name of a schema (`schemas/0`), or `{:bytes, media types}` |
  | `query` | names of parameters (`parameters/0`) |
  | `status` | of the answer, 200 if left out; with `later: true` also 202: the command goes on |
  | `answer` | the answer's schema (`:object` if left out), `nil` for none, or `{:bytes, media types}` beside JSON |

  Who may run it is said by `FleetWeb.Rights`.
  """

  @plan_types ["application/json", "text/plain", "application/octet-stream"]

  plan = fn kind ->
    name = %{mission: "mission", fence: "fence", rally: "rally points"}[kind]

    [
      {{:transfer, {:get_plan, kind}},
       %{
         summary: "Reads the #{name} of a vehicle.",
         query: [:format, :timeout],
         answer: {:bytes, @plan_types}
       }},
      {{:transfer, {:put_plan, kind}},
       %{
         summary: "Writes the #{name} of a vehicle.",
         query: [:format, :timeout, :wait, :id, :force],
         body: {:bytes, @plan_types},
         later: true
       }},
      {{:transfer, {:clear_plan, kind}},
       %{summary: "Clears the #{name} of a vehicle.", query: [:timeout, :wait, :id], later: true}}
    ]
  end

  @operations Map.new(
                [
                  {:index, %{summary: "The resources and their methods."}},
                  {:openapi, %{summary: "This description."}},
                  {:status, %{summary: "The most used state of all vehicles."}},
                  {:diagnosis, %{summary: "What is wrong, and what to do about it."}},
                  {:vehicles, %{summary: "All vehicles.", query: [:tag]}},
                  {:vehicle, %{summary: "Everything that is known of a vehicle."}},
                  {:vehicle_events, %{summary: "The latest events of a vehicle.", query: [:limit, :since]}},
                  {:events, %{summary: "The latest events of all vehicles.", query: [:limit, :since]}},
                  {:save,
                   %{summary: "Saves the last minutes of a vehicle as a recording.", body: :save, status: 201}},
                  {:record_vehicle, %{summary: "Records a vehicle, or stops that.", body: :mode}},
                  {:vehicle_signing, %{summary: "How a vehicle is signed."}},
                  {:sign_vehicle,
                   %{summary: "Gives a vehicle a signing key, or takes it away.", body: :signing}},
                  {:signing, %{summary: "Signed links and vehicles."}},
                  {:signing_capability,
                   %{summary: "Which vehicles can sign, and by which links they can be given a key."}},
                  {:links, %{summary: "All links."}},
                  {:add_link,
                   %{
                     summary: "Adds a link; it lives until it is removed, or the gateway ends.",
                     body: :link,
                     status: 201
                   }},
                  {:remove_link, %{summary: "Closes and forgets a link.", status: 204, answer: nil}},
                  {:record_link, %{summary: "Records a link, or stops that.", body: :mode}},
                  {:recorder, %{summary: "What is recorded, and the files that there are."}},
                  {:download, %{summary: "A recording.", answer: {:bytes, ["application/octet-stream"]}}},
                  {:clients, %{summary: "Endpoints for clients, and the clients that are connected."}},
                  {:add_client, %{summary: "Adds an endpoint for clients.", body: :client, status: 201}},
                  {:remove_client,
                   %{summary: "Removes an endpoint, or disconnects a client.", status: 204, answer: nil}},
                  {:rules, %{summary: "The routing rules of links and clients."}},
                  {:change_rules, %{summary: "Changes the rules of a link or client.", body: :rules}},
                  {:reset_rules, %{summary: "Brings the configured rules back.", status: 204, answer: nil}},
                  {:command,
                   %{
                     summary: "Gives a command, and waits for its result.",
                     body: :command,
                     query: [:wait],
                     later: true
                   }},
                  {:look_at_command, %{summary: "How far a command is, or its result."}},
                  {:cancel_command, %{summary: "Cancels a command.", status: 202}},
                  {:shadow,
                   %{summary: "What is desired of a vehicle, what is reported, and how they differ."}},
                  {:update_shadow, %{summary: "Changes what is desired.", body: :object}},
                  {:delete_shadow, %{summary: "Desires nothing any more.", query: [:version]}},
                  {:shadow_delta, %{summary: "What is desired and not so."}},
                  {:operations, %{summary: "Operations on many vehicles, without their vehicles."}},
                  {:begin_operation,
                   %{
                     summary: "Begins an operation on many vehicles, which goes on by itself.",
                     body: :operation,
                     status: 202
                   }},
                  {:operation, %{summary: "An operation, and what became of each vehicle."}},
                  {:stop_operation, %{summary: "Nothing of an operation begins any more."}},
                  {:policy, %{summary: "The policy in force."}},
                  {:reload_policy, %{summary: "Reads the policy and its fences again.", body: :nothing}},
                  {:store_plan,
                   %{
                     summary: "Stores a .plan file for desired states.",
                     body: {:bytes, @plan_types},
                     status: 201
                   }},
                  {:command_types, %{summary: "The commands with their parameters."}},
                  {:log, %{summary: "The levels of the log."}},
                  {:change_log, %{summary: "Changes the levels of the log.", body: :log}},
                  {:reload_config,
                   %{
                     summary:
                       "Reads the configuration again and puts in force what can change without a restart.",
                     body: :nothing
                   }},
                  {:issue_ticket,
                   %{summary: "A ticket that opens one WebSocket.", body: :nothing, status: 201}},
                  {{:transfer, :list_params},
                   %{
                     summary: "All parameters of a vehicle.",
                     query: [:format, :component, :timeout],
                     answer: {:bytes, ["application/json", "text/plain"]}
                   }},
                  {{:transfer, :load_params},
                   %{
                     summary: "Sets several parameters of a vehicle.",
                     query: [:format, :timeout, :wait, :id, :unknown],
                     body: {:bytes, ["application/json", "text/plain"]},
                     later: true
                   }},
                  {{:transfer, :param_metadata},
                   %{summary: "What the vehicle itself says of its parameters.", query: [:timeout]}},
                  {{:transfer, :get_param}, %{summary: "One parameter.", query: [:component, :timeout]}},
                  {{:transfer, :set_param},
                   %{
                     summary: "Sets a parameter.",
                     query: [:component, :timeout, :wait, :id],
                     body: :param,
                     later: true
                   }},
                  {{:transfer, :read_file},
                   %{
                     summary: "A file on board; with list, a folder; with crc, its checksum.",
                     query: [:timeout, :list, :crc],
                     answer: {:bytes, ["application/octet-stream"]}
                   }},
                  {{:transfer, :write_file},
                   %{
                     summary: "Writes a file on board.",
                     query: [:timeout, :wait, :id],
                     body: {:bytes, ["application/octet-stream"]},
                     later: true
                   }},
                  {{:transfer, :remove_file},
                   %{summary: "Removes a file on board.", query: [:timeout, :wait, :id], later: true}},
                  {{:transfer, :list_logs}, %{summary: "The logs on board.", query: [:timeout]}},
                  {{:transfer, :download_log},
                   %{
                     summary: "A log on board.",
                     query: [:timeout],
                     answer: {:bytes, ["application/octet-stream"]}
                   }}
                ] ++ Enum.flat_map([:mission, :fence, :rally], plan)
              )

  @texts %{type: :string}

  @schemas %{
    object: %{type: :object},
    nothing: %{type: :object, maxProperties: 0},
    save: %{type: :object, properties: %{reason: %{type: :string, maxLength: 64}}},
    mode: %{type: :object, required: [:mode], properties: %{mode: %{enum: ~w(always armed off)}}},
    signing: %{
      type: :object,
      additionalProperties: false,
      required: [:action],
      properties: %{
        action: %{enum: ~w(enrol revoke discard)},
        key: %{enum: ~w(configured generate previous)},
        link: @texts,
        component: %{type: :integer, minimum: 1, maximum: 255}
      }
    },
    link: %{
      type: :object,
      additionalProperties: false,
      required: [:url],
      properties: %{
        url: @texts,
        id: @texts,
        network: @texts,
        label: @texts,
        group: @texts,
        high_latency: %{type: :boolean}
      }
    },
    client: %{
      type: :object,
      additionalProperties: false,
      required: [:url],
      properties: %{
        url: @texts,
        id: @texts,
        networks: %{type: :array, items: @texts},
        access: %{enum: ~w(full read)}
      }
    },
    rules: %{type: :object, minProperties: 1},
    command: %{
      type: :object,
      required: [:type],
      properties: %{id: @texts, type: @texts, params: %{type: :object}, deadline: @texts}
    },
    operation: %{
      type: :object,
      additionalProperties: false,
      properties: %{
        id: @texts,
        vehicles: %{type: :array, items: @texts, minItems: 1, maxItems: 2_000},
        tag: @texts,
        command: %{type: :object, required: [:type], properties: %{type: @texts, params: %{type: :object}}},
        shadow: %{type: :object},
        step: %{type: :integer, minimum: 1, maximum: 100, default: 20},
        pause_s: %{type: :number, minimum: 0, maximum: 3600, default: 0},
        halt_ratio: %{type: :number, minimum: 0, maximum: 1, default: 1},
        await: %{enum: ~w(written converged)},
        timeout_s: %{type: :number, minimum: 1, maximum: 300}
      }
    },
    log: %{
      type: :object,
      additionalProperties: false,
      minProperties: 1,
      properties: %{
        level: %{enum: ~w(debug info notice warning error none)},
        areas: %{
          type: :object,
          additionalProperties: %{enum: ["debug", "info", "notice", "warning", "error", "none", nil]}
        }
      }
    },
    param: %{
      type: :object,
      additionalProperties: false,
      required: [:value],
      properties: %{id: @texts, value: %{type: [:number, :string]}}
    }
  }

  @parameters %{
    limit: {%{type: :integer, minimum: 1, maximum: 1000, default: 100}, "How many, the latest ones."},
    since: {@texts, "Only those after this time: ISO 8601 with its offset, or unix seconds."},
    wait:
      {%{type: :integer, minimum: 0, maximum: 20},
       "How many seconds to wait for the result; then 202, and the command goes on."},
    timeout: {%{type: :integer, minimum: 1, maximum: 3600}, "How many seconds the transfer may take."},
    format:
      {@texts, "The form of the text: json, plan, waypoints, param or params, whichever the resource has."},
    id: {@texts, "Id of the command, for asking for it again."},
    unknown: {%{enum: ~w(skip refuse)}, "What to do with parameters that the vehicle does not have."},
    force:
      {%{type: :boolean, default: false}, "Sends a fence that the vehicle, which flies, breaches at once."},
    component:
      {%{type: :integer, minimum: 1, maximum: 255},
       "The component whose parameters are meant, such as 100, a camera; without it the autopilot."},
    version: {%{type: :integer}, "The version that this is meant for."},
    tag: {@texts, "Only vehicles with this tag."},
    list: {@texts, "Lists a folder."},
    crc: {@texts, "Gives the checksum."}
  }

  @doc "The description of each action."
  @spec all() :: %{(atom() | tuple()) => map()}
  def all, do: @operations

  @doc "The schemas of bodies, by name."
  @spec schemas() :: %{atom() => map()}
  def schemas, do: @schemas

  @doc "The parameters of queries: schema and meaning, by name."
  @spec parameters() :: %{atom() => {map(), String.t()}}
  def parameters, do: @parameters
end
