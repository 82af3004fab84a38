defmodule Aerie.Fleet.Bridge.Commands.Transfers.Schema do
  @moduledoc """
  JSON Schemas of the requests and replies of `Aerie.Fleet.Bridge.Commands.Transfers`, by area and operation. What the schema of a request
  takes is not refused for its shape, but for the content of a plan or of a file of parameters. Pure.
  """

  import Aerie.Base.JsonSchema

  alias Aerie.Control.Params.Table
  alias Aerie.Fleet.Bridge.Commands.Transfers

  @type t :: Aerie.Base.JsonSchema.t()

  # A parameter of MAVLink, or a longer one of a command line.
  @name "^([!-~]{1,16}|[a-z0-9_]{1,64})$"
  @largest 3.4028235e38
  @base64 "^([A-Za-z0-9+/]{4})*([A-Za-z0-9+/]{2}==|[A-Za-z0-9+/]{3}=)?$"

  @doc "The name of a parameter as programs give it."
  @spec name() :: t()
  def name, do: %{type: :string, pattern: @name}

  @doc "A parameter's value: a number, or for a component of PARAM_EXT a text (docs/transfers.md)."
  @spec value() :: t()
  def value, do: %{anyOf: [number(-@largest, @largest), %{type: :string, maxLength: 45}]}

  @doc "Several parameters with their values."
  @spec values() :: t()
  def values do
    %{
      type: :object,
      propertyNames: name(),
      additionalProperties: number(-@largest, @largest),
      maxProperties: Table.max()
    }
  end

  @doc "The request of an operation."
  @spec request({area :: String.t(), operation :: String.t()}) :: t()
  def request({area, operation} = what) do
    {properties, required, more} = fields(what)
    changes? = Transfers.changes?(what)

    common = %{
      id: described(token(), "the same id is the same request; progress is published with it"),
      vehicle: described(token(), "if given, that of the subject"),
      type: %{const: "#{area}.#{operation}"},
      source: described(%{type: :string}, "a remark"),
      timeout: %{
        type: [:number, :null],
        exclusiveMinimum: 0,
        maximum: Aerie.Control.Transfers.max_timeout_s(),
        description: "how long it may take (s)"
      }
    }

    object(Map.merge(common, properties), if(changes?, do: [:id | required], else: required), more)
  end

  defp fields({"params", "list"}), do: {%{component: component()}, [], []}
  defp fields({"params", "get"}), do: {%{name: name(), component: component()}, [:name], []}

  defp fields({"params", "set"}) do
    properties = %{name: name(), value: %{type: [:number, :string]}, component: component()}
    text = %{type: :string, maxLength: 45}
    of_component = %{component: %{type: :integer}, value: %{anyOf: [%{type: :number}, text]}}

    alternatives = [
      %{properties: %{component: %{type: :null}, value: number(-@largest, @largest)}},
      %{required: [:component], properties: of_component}
    ]

    {properties, [:name, :value], [anyOf: alternatives]}
  end

  defp fields({"params", "load"}) do
    file = described(%{type: :string}, "the text of a parameter file")
    {%{values: values(), file: file}, [], [oneOf: [%{required: [:values]}, %{required: [:file]}]]}
  end

  defp fields({"params", "metadata"}) do
    names = described(nullable(%{type: :array, items: %{type: :string}}), "which; all if left out")
    {%{names: names}, [], []}
  end

  defp fields({"mission", "put"}) do
    force =
      described(%{type: [:boolean, :null]}, "sends a fence even if the vehicle in flight breaches it at once")

    {%{kind: kind(), plan: ref("plan"), force: force}, [:plan], []}
  end

  defp fields({"mission", _get_or_clear}), do: {%{kind: kind()}, [], []}

  defp fields({"files", "write"}) do
    data = described(%{type: :string, pattern: @base64, contentEncoding: :base64}, "the bytes in base64")
    {%{path: path(), data: data}, [:path, :data], []}
  end

  defp fields({"files", _operation}), do: {%{path: path()}, [:path], []}
  defp fields({"logs", "list"}), do: {%{}, [], []}

  defp fields({"logs", "read"}) do
    properties = %{
      log: log(),
      offset: Map.put(integer(0, 0xFFFFFFFF), :default, 0),
      bytes: described(integer(1, Transfers.max_piece()), "the most bytes of this piece")
    }

    {properties, [:log], []}
  end

  defp component do
    %{
      type: [:integer, :null],
      minimum: 1,
      maximum: 255,
      description: "the component whose parameters are meant; the autopilot if left out"
    }
  end

  defp kind, do: %{enum: ["mission", "fence", "rally", nil], default: "mission"}
  # What a packet of MAVFTP has room for.
  defp path, do: bytes(239)

  @doc "A .plan file of QGroundControl as an object. Which items and shapes it may have is in docs/transfers.md."
  @spec plan() :: t()
  def plan do
    section = %{type: :object}

    object(
      %{
        fileType: %{const: "Plan"},
        version: %{const: 1},
        mission: section,
        geoFence: section,
        rallyPoints: section
      },
      [:fileType],
      open: true
    )
  end

  @doc "The reply of an operation that succeeds; a change has a result, and so has whatever fails."
  @spec reply({area :: String.t(), operation :: String.t()}) :: t()
  def reply(what) do
    if Transfers.changes?(what) do
      ref("result")
    else
      read = %{id: nullable(token()), result: %{const: "completed"}, reason: %{type: :null}}
      given = given(what)
      object(Map.merge(read, given), [:id, :result, :reason | Map.keys(given)], open: true)
    end
  end

  defp given({"params", "list"}),
    do: %{count: count(), params: %{type: :array, items: object(param(), [:name, :value, :type], open: true)}}

  defp given({"params", "get"}), do: param()

  defp given({"params", "metadata"}),
    do: %{params: %{type: :array, items: object(%{name: %{type: :string}}, [:name], open: true)}}

  defp given({"mission", "get"}) do
    %{
      kind: %{enum: ~w(mission fence rally)},
      items: count(),
      digest: described(%{type: :string}, "of the content"),
      opaque_id: described(%{type: [:integer, :null]}, "the vehicle's own id of it"),
      remarks:
        described(%{type: :array, items: %{type: :string}}, "what QGroundControl would not read of the plan"),
      plan: ref("plan")
    }
  end

  defp given({"files", "list"}) do
    entry =
      object(
        %{kind: %{enum: ~w(file directory)}, name: %{type: :string}, size: nullable(count())},
        [:kind, :name, :size],
        open: true
      )

    %{path: %{type: :string}, entries: %{type: :array, maxItems: 10_000, items: entry}}
  end

  defp given({"files", "read"}), do: %{path: %{type: :string}, data: data()}
  defp given({"files", "crc"}), do: %{path: %{type: :string}, crc32: integer(0, 0xFFFFFFFF)}

  defp given({"logs", "list"}),
    do: %{logs: %{type: :array, items: Map.put(log(), :additionalProperties, true)}}

  defp given({"logs", "read"}) do
    next = described(nullable(count()), "where the next piece begins; null: this is the last one")
    %{size: count(), offset: count(), next: next, data: data()}
  end

  defp param do
    %{
      name: %{type: :string},
      value: described(%{type: [:number, :string, :null]}, "null: not a number on board"),
      type: described(integer(0, 255), "MAV_PARAM_TYPE"),
      default: described(%{type: [:number, :null]}, "the firmware's default, if the vehicle says it"),
      exact: described(%{type: :boolean}, "whether the value can be changed without a loss")
    }
  end

  defp log do
    time = described(%{type: [:integer, :null]}, "unix time; null if the vehicle did not know it (s)")
    object(%{id: integer(0, 0xFFFF), size: count(), time: time}, [:id, :size])
  end

  defp data, do: %{type: :string, pattern: @base64, contentEncoding: :base64}
  defp count, do: %{type: :integer, minimum: 0}

  @doc "A request that was not understood or refused for its size."
  @spec refusal() :: t()
  def refusal do
    wrong =
      object(
        %{key: %{type: :string}, expected: %{type: :string}, got: %{type: [:string, :null]}},
        [:key, :expected],
        open: true
      )

    object(
      %{
        id: %{type: [:string, :null]},
        result: %{enum: ~w(rejected denied failed)},
        rule: described(%{type: :string}, "malformed, size, signature, policy, busy, …"),
        reason: %{type: :string},
        errors: %{type: :array, items: wrong}
      },
      [:id, :result, :rule, :reason],
      open: true
    )
  end
end
