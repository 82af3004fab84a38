defmodule Aerie.Control.Missions do
  @moduledoc """
  The missions, fences and rally points of a vehicle, for programs in Elixir:

      {:ok, plan} = Aerie.Control.Missions.import(File.read!("survey.plan"), :plan) {:ok,
      %Aerie.Vehicle.Command.Result{status: :completed}} = Aerie.Control.Missions.upload(gateway, "VID-001", :mission,
      plan) {:ok, %{plan: plan}} = Aerie.Control.Missions.download(gateway, "VID-001", :mission)

  A plan (`Protocols.Mission.Plan`) has all three; each kind is sent and read separately. The policy judges every item
  before the first one is sent (`Aerie.Control.Mission.Known`), and the plan is read back afterwards. The options are
  those of `t:Aerie.Control.Transfers.option/0`.
  """

  @behaviour Aerie.Control.Commands.Change

  alias Aerie.Control.Commands.{Change, Gateways}
  alias Aerie.Base.Files.Text
  alias Aerie.Base.Names
  alias Aerie.Control.Transfers
  alias Protocols.Mission
  alias Aerie.Vehicle.Firmware
  alias Aerie.Vehicle.Command.{Error, Refusal, Result}
  alias Aerie.Control.Mission.{Known, OwnFence}
  alias Protocols.Mission.{Item, Onboard, Plan, Transfer}
  alias Msp.Mission.Mwp
  alias Protocols.Mission.File.{QgcPlan, Waypoints}
  alias Protocols.Mission.Transfer.Compare
  alias Aerie.Control.Policy.Mavlink
  alias MavCodec.Messages, as: M

  @kinds %{mission: 0, fence: 1, rally: 2}
  @names %{mission: "a mission", fence: "a fence", rally: "rally points"}
  # An item that is sent or read.
  @item_ms 5_000
  # The beginning of a file that shows whether it is JSON.
  @looked_at 1_000

  @type kind :: Plan.kind()

  @typedoc """
    * `:plan` - a plan with only the kind that was read
    * `:items` - the items as the vehicle stores them
    * `:opaque_id` - the vehicle's id for it (W7), or nil
    * `:digest` - digest of the items (`Protocols.Mission.Plan.digest/1`)
  """
  @type stored :: %{
          plan: Plan.t(),
          items: [Item.t()],
          opaque_id: pos_integer() | nil,
          digest: String.t()
        }

  @doc "The kinds of plans."
  @spec kinds() :: [kind()]
  def kinds, do: [:mission, :fence, :rally]

  @doc "Why the firmware of a vehicle has no plans of this kind; nil if it has, or may have."
  @spec gap(vehicle :: map(), kind()) :: String.t() | nil
  def gap(%{autopilot: autopilot}, kind), do: Firmware.of(autopilot).plan_gap(@kinds[kind])

  @doc """
  What the policy has against the parts of a plan for the vehicle of a snapshot, if `source` sends them: the part, the
  number of the item there (nil: the part as a whole), and the reason.
  """
  @spec refused(Names.gateway(), Plan.t(), [kind()], map(), source :: map()) ::
          {:ok, [{kind(), non_neg_integer() | nil, String.t()}]} | {:error, String.t()}
  defdelegate refused(gateway, plan, parts, snapshot, source), to: Known

  @doc "Reads a kind of plan from the vehicle."
  @spec download(Names.gateway(), vehicle :: String.t(), kind(), [Transfers.option()]) ::
          {:ok, stored()} | {:error, Result.t()}
  def download(gateway, vehicle, kind, options \\ []) do
    type = Map.fetch!(@kinds, kind)
    asked = {"mission", "get", %{"kind" => Atom.to_string(kind)}}

    with :here <- Transfers.read_remote(gateway, vehicle, asked, options),
         {:ok, result} <- read(gateway, vehicle, kind, options) do
      plan = Onboard.put(%Plan{}, type, result.items, protocol(gateway, vehicle))

      {:ok,
       %{plan: plan, items: result.items, opaque_id: result.opaque_id, digest: Plan.digest(result.items)}}
    else
      {:ok, %{"plan" => plan} = answer} -> outcome(plan, answer, type, protocol(gateway, vehicle))
      {:ok, _other} -> no_plan(Refusal.text(:no_mission))
      error -> error
    end
  end

  defp no_plan(text), do: Transfers.error(Refusal.ended(:no_plan, why: text))

  # Another gateway's answer (`plain/2`).
  defp outcome(plan, answer, type, protocol) do
    case plan |> JSON.encode!() |> __MODULE__.import(:plan) do
      {:ok, plan} ->
        items = Onboard.items(plan, type, protocol)
        id = if is_integer(answer["opaque_id"]), do: answer["opaque_id"]
        {:ok, %{plan: plan, items: items, opaque_id: id, digest: Plan.digest(items)}}

      {:error, text} ->
        no_plan(text)
    end
  end

  @doc "Like `download/4`, but returns the transfer's result. Identical reads at the same time share one transfer."
  @spec read(Names.gateway(), vehicle :: String.t(), kind(), [Transfers.option()]) ::
          {:ok, Mission.Result.t()} | {:error, Result.t()}
  def read(gateway, vehicle, kind, options \\ []) do
    type = Map.fetch!(@kinds, kind)

    # What a firmware with missions lacks beside them is read as empty.
    with {:ok, snapshot} <- Transfers.vehicle(gateway, vehicle),
         {:gap, nil} <- {:gap, gap(snapshot, :mission)} do
      transfer = Map.put(transfer(:download, [], type, snapshot.vehicle_type), :share, {:plan, type})
      {result, nil} = Transfers.read(gateway, snapshot, transfer, options)
      result
    else
      {:gap, reason} -> Transfers.error({:rejected, reason})
      {:error, result} -> {:error, result}
    end
  end

  @doc "Reads all three kinds into one plan."
  @spec download_all(Names.gateway(), vehicle :: String.t(), [Transfers.option()]) ::
          {:ok, Plan.t()} | {:error, Result.t()}
  def download_all(gateway, vehicle, options \\ []) do
    with {:ok, mission} <- download(gateway, vehicle, :mission, options),
         {:ok, fence} <- download(gateway, vehicle, :fence, options),
         {:ok, rally} <- download(gateway, vehicle, :rally, options) do
      {:ok, mission.plan |> Plan.put_part(:fence, fence.plan) |> Plan.put_part(:rally, rally.plan)}
    end
  end

  @doc """
  Replaces a kind of plan on board, and reads it back. `:completed`: the vehicle has it, and did not report that it
  cannot fly it where its firmware checks that; `:accepted`: the firmware's check reported nothing; `:rejected`: the
  vehicle refused it, possibly after acknowledging it. Needs the permission `mission`. The details have `"on_board"`:
  `"new"`, `"old"`, `"other"` or `"unknown"`, and `"remarks"`: what the firmware does not keep of it, and what is wrong
  with the plan by its own fence (`Aerie.Control.Mission.OwnFence`).

  A plan that has nothing of this kind is refused: what is aboard is removed by `clear/4` only. So is one with a place
  without a height, which would reach the vehicle as NaN. Refused as well, unless the option `force: true` is given, is
  a fence that the vehicle, which is known to fly with its fence on, would breach at once.
  """
  @spec upload(Names.gateway(), vehicle :: String.t(), kind(), Plan.t(), [
          Transfers.option() | {:force, boolean()}
        ]) ::
          Transfers.answer()
  def upload(gateway, vehicle, kind, %Plan{} = plan, options \\ []) do
    {force, options} = Keyword.pop(options, :force, false)
    items = Onboard.items(plan, @kinds[kind], protocol(gateway, vehicle))

    cond do
      Plan.empty?(plan, kind) ->
        {:error,
         [
           Error.new(
             "plan",
             "#{@names[kind]} (there is none in it; to remove what is aboard, clear it)",
             :rule
           )
         ]}

      (heightless = Plan.heightless(plan, kind)) != nil ->
        {:error, [Error.new(Atom.to_string(kind), heightless, :rule)]}

      length(items) > Transfer.limit() ->
        {:error, [Error.new(Atom.to_string(kind), "at most #{Transfer.limit()} items", length(items))]}

      true ->
        change(gateway, vehicle, {:upload, kind, plan, items, force}, put(kind, plan, force), options)
    end
  end

  @doc """
  Removes a kind of plan from the vehicle, and reads back that it is gone. The details have `"removed"`: what was
  aboard, such as `"4 corners"`, if it could be read before. Needs the permission `mission`, and for a fence
  `protection`.
  """
  @spec clear(Names.gateway(), vehicle :: String.t(), kind(), [Transfers.option()]) :: Transfers.answer()
  def clear(gateway, vehicle, kind, options \\ []) do
    asked = {"mission", "clear", %{"kind" => Atom.to_string(kind)}}
    change(gateway, vehicle, {:clear, kind, %Plan{}, [], true}, asked, options)
  end

  defp change(gateway, vehicle, {action, kind, _plan, items, force} = what, remote_request, options) do
    sent = %{action: Atom.to_string(action), items: length(items), digest: Plan.digest(items)}

    change = %Change{
      module: __MODULE__,
      what: what,
      facts: facts(@kinds[kind], length(items)),
      params: if(action == :upload and force, do: Map.put(sent, :forced, true), else: sent),
      limit_ms: limit_ms(items),
      remote_request: remote_request
    }

    gateway
    |> Transfers.change(vehicle, change, options)
    |> Known.note(gateway, Gateways.vehicle(gateway, vehicle), @kinds[kind], items)
  end

  @doc "Why a plan could be sent to no vehicle (a place without a height), or nil."
  @spec unsendable(Plan.t()) :: String.t() | nil
  def unsendable(plan) do
    Enum.find_value(kinds(), fn kind ->
      what = Plan.heightless(plan, kind)
      what && "#{kind}: expected #{what}"
    end)
  end

  @doc "Describes a plan of a kind from its items: `\"4 corners\"`, `\"nothing\"`."
  @spec contents([Item.t()], kind(), module()) :: String.t()
  def contents(items, kind, protocol) do
    case %Plan{} |> Onboard.put(@kinds[kind], items, protocol) |> Plan.contents(kind) do
      nil -> "nothing"
      text -> text
    end
  end

  # The request to the gateway that hears the vehicle.
  defp put(kind, plan, force) do
    asked = %{"kind" => Atom.to_string(kind), "plan" => plan |> QgcPlan.write() |> JSON.decode!()}
    {"mission", "put", if(force, do: Map.put(asked, "force", true), else: asked)}
  end

  @doc """
  Compares a kind of plan with the vehicle's, by what its firmware keeps: `:same`, or the first item that differs, and
  how.
  """
  @spec verify(Names.gateway(), vehicle :: String.t(), kind(), Plan.t(), [Transfers.option()]) ::
          {:ok, :same | {:differs, seq :: non_neg_integer(), how :: String.t()}} | {:error, Result.t()}
  def verify(gateway, vehicle, kind, plan, options \\ []) do
    with {:ok, stored} <- download(gateway, vehicle, kind, options) do
      type = Map.fetch!(@kinds, kind)
      protocol = protocol(gateway, vehicle)
      items = Onboard.items(plan, type, protocol)

      case Compare.plans(items, stored.items, type, protocol, kind_of(gateway, vehicle)) do
        {:same, _remarks} -> {:ok, :same}
        difference -> {:ok, difference}
      end
    end
  end

  @doc "What a plan does beyond its own fence, and what of that the vehicle of a snapshot would breach at once."
  @spec own_fence(Plan.t(), snapshot :: map() | nil) :: [OwnFence.finding()]
  def own_fence(plan, snapshot), do: OwnFence.check(plan, OwnFence.vehicle(snapshot, now()))

  @typedoc "A file: QGroundControl's, `QGC WPL 110`, or mwp's for iNav. The last two have the mission only."
  @type format :: :plan | :waypoints | :mission

  @doc "Reads a plan from a file's content; `:any`: by how it begins."
  @spec import(binary(), format() | :any) :: {:ok, Plan.t()} | {:error, String.t()}
  def import(text, :plan), do: QgcPlan.read(text)
  def import(text, :waypoints), do: Waypoints.read(text)
  def import(text, :mission), do: Mwp.read(text)

  def import(text, :any) do
    beginning = text |> Text.unmarked() |> binary_slice(0, @looked_at) |> String.trim_leading()

    format =
      cond do
        String.starts_with?(beginning, ["{", "["]) -> :plan
        String.starts_with?(beginning, "<") -> :mission
        true -> :waypoints
      end

    __MODULE__.import(text, format)
  end

  @doc "A plan as a file's content. As a `:mission` it has to be one that iNav can fly."
  @spec export(Plan.t(), format()) :: {:ok, binary()} | {:error, String.t()}
  def export(plan, :plan), do: {:ok, QgcPlan.write(plan)}
  def export(plan, :waypoints), do: {:ok, Waypoints.write(plan)}
  def export(plan, :mission), do: Mwp.write(plan)

  @doc """
  The answer for NATS and REST, with the plan as in a `.plan` file; `remarks` say what of it QGroundControl would not
  read.
  """
  @spec plain(stored(), kind()) :: map()
  def plain(stored, kind) do
    %{
      kind: kind,
      items: length(stored.items),
      digest: stored.digest,
      opaque_id: stored.opaque_id,
      remarks: Plan.remarks(stored.plan, kind),
      plan: stored.plan |> QgcPlan.write() |> JSON.decode!()
    }
  end

  defp facts(type, count),
    do:
      Mavlink.facts(%M.MissionCount{mission_type: type, count: count}, %{
        autopilot: :generic,
        vehicle_type: "unknown"
      })

  @impl Change
  def review({_action, kind, plan, items, force}, gateway, snapshot, policy, context) do
    read = fn -> read(gateway, snapshot.id, kind) end

    with :allow <- Known.review(policy, context, {gateway, snapshot}, items, @kinds[kind], read),
         do: if(kind == :fence and not force, do: OwnFence.breach(own_fence(plan, snapshot)), else: :allow)
  end

  defp now, do: System.os_time(:microsecond)

  @impl Change
  def transfer({action, kind, _plan, items, _force} = what, gateway, snapshot) do
    op = if action == :upload, do: {:upload, items}, else: :clear

    with nil <- gap(snapshot, kind) do
      transfer = transfer(op, items, @kinds[kind], snapshot.vehicle_type)
      {:ok, Map.put(transfer, :complete, remark(what, gateway, snapshot))}
    else
      lacking -> {:gap, lacking}
    end
  end

  defp remark({:upload, kind, plan, _items, _force}, _gateway, snapshot) do
    remarks = plan |> own_fence(snapshot) |> OwnFence.remarks(kind)
    &Result.remark(&1, remarks)
  end

  # The result says what was removed.
  defp remark({:clear, kind, _plan, _items, _force}, gateway, snapshot) do
    case Transfers.read(gateway, snapshot, transfer(:download, [], @kinds[kind], snapshot.vehicle_type), []) do
      {{:ok, %{items: items}}, nil} ->
        removed = contents(items, kind, Firmware.of(snapshot.autopilot))

        fn
          %{status: :completed} = result -> put_in(result.details["removed"], removed)
          result -> result
        end

      {{:error, _result}, nil} ->
        & &1
    end
  end

  # The items that are sent.
  defp transfer(op, items, type, kind) do
    %{
      lanes: [:mission],
      timeout_ms: limit_ms(items),
      start: fn context, until ->
        Transfer.new(op, type,
          protocol: context.protocol,
          kind: kind,
          target: context.target,
          us: context.us,
          until: until,
          rtt: context.rtt_us,
          item_us: if(context.grows?, do: @item_ms * 1000, else: 0)
        )
      end
    }
  end

  defp limit_ms(items), do: Transfers.time_ms(2 * length(items), @item_ms)

  defp kind_of(gateway, vehicle) do
    case Gateways.vehicle(gateway, vehicle) do
      nil -> "unknown"
      snapshot -> snapshot.vehicle_type
    end
  end

  defp protocol(gateway, vehicle) do
    case Gateways.vehicle(gateway, vehicle) do
      nil -> Firmware.of(:generic)
      snapshot -> Firmware.of(snapshot.autopilot)
    end
  end
end
