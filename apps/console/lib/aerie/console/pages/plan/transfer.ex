defmodule Aerie.Console.Pages.Plan.Transfer do
  @moduledoc """
  Sends a plan to a vehicle or reads it, part by part, for a page, or removes a part that is aboard. The state, with the progress and the
  results, is a pure value; a task does the work and sends messages to the page. It ends with its last part, even if the page has gone.

  Sending never removes anything: a part without content is not sent, nor one that is as it was read. To remove a part it is looked at first
  (`:look`), so that the operator sees what goes; it is removed (`:remove`) if it still is what was seen.
  """

  alias Aerie.Base.Names
  alias Aerie.Control.Missions
  alias Aerie.Fleet
  alias Aerie.Vehicle.Firmware
  alias Protocols.Mission.Plan

  @kinds Missions.kinds()

  @enforce_keys [:ref, :what, :vehicle]
  defstruct [:ref, :what, :vehicle, :kind, :progress, :plan, :aboard, results: []]

  @type what :: :upload | :download | :verify | {:look, Missions.kind()} | {:remove, aboard()}

  @typedoc "A part that is aboard: what it is for people, and its digest."
  @type aboard :: %{kind: Missions.kind(), text: String.t(), digest: String.t()}

  @typedoc """
    * `:kind` - the part that is under way, nil at the end; `:progress` - `%{"phase", "done", "total"}` of it
    * `:results` - by part: `{:ok, text}`, `{:none, text}` for one that was not sent, or `{:error, text}`
    * `:plan` - the plan that was read; `:aboard` - what was found by looking
  """
  @type t :: %__MODULE__{
          ref: reference(),
          what: what(),
          vehicle: String.t(),
          kind: Missions.kind() | nil,
          progress: map() | nil,
          results: [{Missions.kind(), {:ok | :none | :error, String.t()}}],
          plan: Plan.t() | nil,
          aboard: aboard() | nil
        }

  @doc "The effect on each part when a plan is sent; `read` is the plan as it was read from that vehicle, nil if it was not."
  @spec parts(Plan.t(), Plan.t() | nil) :: [{Missions.kind(), :send | {:skip, String.t()}}]
  def parts(plan, read) do
    for kind <- @kinds do
      cond do
        Plan.empty?(plan, kind) ->
          {kind, {:skip, "not sent: the plan has none. What is aboard stays."}}

        read != nil and Plan.part(plan, kind) == Plan.part(read, kind) ->
          {kind, {:skip, "not sent: it is as it was read."}}

        true ->
          {kind, :send}
      end
    end
  end

  @doc "What a button that sends applies to: the vehicle and the plan that it shows."
  @spec target(vehicle :: String.t() | nil, Plan.t()) :: String.t()
  def target(vehicle, plan), do: "#{vehicle} #{:erlang.phash2(plan)}"

  @doc """
  Starts a transfer. The calling process gets `{:transfer, ref, message}` for `update/2`. `press` is the id of the button press; each part has
  an id made from it. The option `:read` is that of `parts/2`.
  """
  @spec start(what(), Names.gateway(), String.t(), Plan.t(), String.t(), keyword()) :: t()
  def start(what, gateway, vehicle, plan, press, options) do
    {page, ref} = {self(), make_ref()}
    {read, options} = Keyword.pop(options, :read)
    options = Keyword.merge(options, progress: {page, {:transfer, ref}})

    {:ok, _pid} =
      Task.start(fn ->
        for {kind, job} <- jobs(what, plan, read) do
          send(page, {:transfer, ref, {:begun, kind}})
          own = Keyword.put(options, :id, "#{String.slice(press, 0, 56)}-#{kind}")
          send(page, {:transfer, ref, {:ended, kind, run(job, gateway, vehicle, kind, plan, own)}})
        end

        send(page, {:transfer, ref, :done})
      end)

    %__MODULE__{ref: ref, what: what, vehicle: vehicle}
  end

  defp jobs(:upload, plan, read), do: parts(plan, read)
  defp jobs({:look, kind}, _plan, _read), do: [{kind, :look}]
  defp jobs({:remove, aboard}, _plan, _read), do: [{aboard.kind, {:remove, aboard}}]
  defp jobs(what, _plan, _read), do: for(kind <- @kinds, do: {kind, what})

  defp run({:skip, text}, _gateway, _vehicle, _kind, _plan, _options), do: {:none, text}

  defp run(:send, gateway, vehicle, kind, plan, options) do
    sent = Plan.contents(plan, kind)

    case Missions.upload(gateway, vehicle, kind, plan, options) do
      {:ok, %{status: :completed} = result} -> {:ok, "#{sent}, verified" <> remarks(result)}
      {:ok, %{status: :accepted} = result} -> {:ok, "#{sent}, on board" <> remarks(result)}
      other -> failed(other)
    end
  end

  defp run(:download, gateway, vehicle, kind, _plan, options) do
    case Missions.download(gateway, vehicle, kind, options) do
      {:ok, %{plan: plan}} -> {:ok, "read: #{read(plan, kind)}", plan}
      error -> failed(error)
    end
  end

  defp run(:verify, gateway, vehicle, kind, plan, options) do
    case Missions.verify(gateway, vehicle, kind, plan, options) do
      {:ok, :same} -> {:ok, "the same on board"}
      {:ok, {:differs, seq, how}} -> {:error, "differs at item #{seq} of the vehicle: #{how}"}
      error -> failed(error)
    end
  end

  defp run(:look, gateway, vehicle, kind, _plan, options) do
    case aboard(gateway, vehicle, kind, options) do
      {:ok, %{text: "nothing"}} -> {:none, "nothing on board"}
      {:ok, aboard} -> {:ok, "#{aboard.text} on board", aboard}
      error -> failed(error)
    end
  end

  defp run({:remove, %{digest: digest} = seen}, gateway, vehicle, kind, _plan, options) do
    with {:ok, %{digest: ^digest}} <- aboard(gateway, vehicle, kind, Keyword.delete(options, :id)),
         {:ok, %{status: :completed}} <- Missions.clear(gateway, vehicle, kind, options) do
      {:ok, "removed: #{seen.text}"}
    else
      {:ok, %{text: text}} -> {:error, "not removed: meanwhile #{text} on board"}
      other -> failed(other)
    end
  end

  defp aboard(gateway, vehicle, kind, options) do
    with {:ok, stored} <- Missions.download(gateway, vehicle, kind, options) do
      protocol = Firmware.of((Fleet.vehicle(gateway, vehicle) || %{autopilot: :generic}).autopilot)
      {:ok, %{kind: kind, text: Missions.contents(stored.items, kind, protocol), digest: stored.digest}}
    end
  end

  defp read(plan, kind),
    do: Enum.join(["#{Plan.contents(plan, kind) || "nothing"} on board" | Plan.remarks(plan, kind)], "; ")

  defp remarks(%{details: %{"remarks" => [_ | _] = remarks}}), do: "; but " <> Enum.join(remarks, "; ")
  defp remarks(_result), do: ""

  defp failed({:pending, _id}), do: {:error, "it is still under way"}
  defp failed({_ok_or_error, %{} = result}), do: {:error, sentence(result)}
  defp failed({:error, errors}), do: {:error, Enum.join(errors, "; ")}

  defp sentence(%{status: status, reason: nil}), do: Atom.to_string(status)
  defp sentence(%{status: status, reason: reason}), do: "#{status}: #{reason}"

  @doc "The name of a part."
  @spec label(Missions.kind()) :: String.t()
  def label(:mission), do: "Mission"
  def label(:fence), do: "Fence"
  def label(:rally), do: "Rally points"

  @doc "Handles a message of the task; `:done` is true at its end."
  @spec update(t(), term()) :: t()
  def update(transfer, {:begun, kind}), do: %{transfer | kind: kind, progress: nil}
  def update(transfer, {:progress, progress}), do: %{transfer | progress: progress}
  def update(transfer, :done), do: %{transfer | kind: nil, progress: nil}

  def update(transfer, {:ended, kind, {:ok, text, %Plan{} = plan}}),
    do: %{
      update(transfer, {:ended, kind, {:ok, text}})
      | plan: Plan.put_part(transfer.plan || %Plan{}, kind, plan)
    }

  def update(transfer, {:ended, kind, {:ok, text, aboard}}),
    do: %{update(transfer, {:ended, kind, {:ok, text}}) | aboard: aboard}

  def update(transfer, {:ended, kind, {outcome, text}}),
    do: %{transfer | progress: nil, results: transfer.results ++ [{kind, {outcome, text}}]}

  @doc "Whether the transfer has ended."
  @spec over?(t()) :: boolean()
  def over?(transfer), do: transfer.kind == nil and transfer.results != []

  @doc "The progress of the part that is under way, 0..1, or nil."
  @spec share(t()) :: float() | nil
  def share(%{progress: %{"done" => done, "total" => total}})
      when is_integer(done) and is_integer(total) and total > 0,
      do: min(done / total, 1.0)

  def share(_transfer), do: nil
end
