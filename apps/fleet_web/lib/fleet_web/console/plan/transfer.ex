defmodule FleetWeb.Console.Plan.Transfer do
  @moduledoc """
  Sends a plan to a vehicle or reads it, part by part, for a page. The state, with the progress and the results, is a pure value; a
  task does the work and sends messages to the page. It ends with its last part, even if the page has gone.
  """

  alias Aerie.{Missions, Names}
  alias Aerie.Command.{Error, Result}
  alias Aerie.Mission.Plan
  alias Aerie.Policy.Roles

  @kinds Missions.kinds()

  @enforce_keys [:ref, :what, :vehicle]
  defstruct [:ref, :what, :vehicle, :kind, :progress, results: [], plan: nil]

  @typedoc """
    * `:kind` - the part that is under way, nil at the end; `:progress` - `%{"phase", "done", "total"}` of it
    * `:results` - by part: `{:ok, text}` or `{:error, text}`
    * `:plan` - the plan that was read
  """
  @type t :: %__MODULE__{
          ref: reference(),
          what: :upload | :download | :verify,
          vehicle: String.t(),
          kind: Missions.kind() | nil,
          progress: map() | nil,
          results: [{Missions.kind(), {:ok | :error, String.t()}}],
          plan: Plan.t() | nil
        }

  @doc """
  Starts a transfer. The calling process gets `{:transfer, ref, message}` for `update/2`. `press` is the id of the button press; each part has
  an id made from it.
  """
  @spec start(:upload | :download | :verify, Names.gateway(), String.t(), Plan.t(), String.t(), keyword()) ::
          t()
  def start(what, gateway, vehicle, plan, press, options) do
    {page, ref} = {self(), make_ref()}
    options = Keyword.merge(options, progress: {page, {:transfer, ref}})

    {:ok, _pid} =
      Task.start(fn ->
        for kind <- @kinds do
          send(page, {:transfer, ref, {:begun, kind}})
          own = Keyword.put(options, :id, "#{String.slice(press, 0, 56)}-#{kind}")
          send(page, {:transfer, ref, {:ended, kind, part(what, gateway, vehicle, kind, plan, own)}})
        end

        send(page, {:transfer, ref, :done})
      end)

    %__MODULE__{ref: ref, what: what, vehicle: vehicle}
  end

  # Sending no fence removes the one on board. Who may not do that sends the rest.
  defp part(:upload, gateway, vehicle, :fence, %Plan{fence: [], fence_return: nil} = plan, options) do
    if Roles.allowed?(options[:as], :protection),
      do: upload(gateway, vehicle, :fence, plan, options),
      else:
        {:ok,
         "not sent: the plan has no fence, and to remove the one on board needs the permission protection"}
  end

  defp part(:upload, gateway, vehicle, kind, plan, options),
    do: upload(gateway, vehicle, kind, plan, options)

  defp part(:download, gateway, vehicle, kind, _plan, options) do
    case Missions.download(gateway, vehicle, kind, options) do
      {:ok, %{plan: plan, items: items}} -> {:ok, "read, #{length(items)} items on board", plan}
      {:error, result} -> {:error, sentence(result)}
    end
  end

  defp part(:verify, gateway, vehicle, kind, plan, options) do
    case Missions.verify(gateway, vehicle, kind, plan, options) do
      {:ok, :same} -> {:ok, "the same on board"}
      {:ok, {:differs, seq, how}} -> {:error, "differs at item #{seq} of the vehicle: #{how}"}
      {:error, result} -> {:error, sentence(result)}
    end
  end

  defp upload(gateway, vehicle, kind, plan, options) do
    case Missions.upload(gateway, vehicle, kind, plan, options) do
      {:ok, %Result{status: :completed}} -> {:ok, "on board, and read back"}
      {:ok, %Result{status: :accepted}} -> {:ok, "on board"}
      {:ok, result} -> {:error, sentence(result)}
      {:pending, _id} -> {:error, "it is still under way"}
      {:error, errors} -> {:error, Error.text(errors)}
    end
  end

  defp sentence(%Result{status: status, reason: nil}), do: Atom.to_string(status)
  defp sentence(%Result{status: status, reason: reason}), do: "#{status}: #{reason}"

  @doc "Handles a message of the task; `:done` is true at its end."
  @spec update(t(), term()) :: t()
  def update(transfer, {:begun, kind}), do: %{transfer | kind: kind, progress: nil}
  def update(transfer, {:progress, progress}), do: %{transfer | progress: progress}
  def update(transfer, :done), do: %{transfer | kind: nil, progress: nil}

  def update(transfer, {:ended, kind, {:ok, text, plan}}),
    do: %{update(transfer, {:ended, kind, {:ok, text}}) | plan: joined(transfer.plan || %Plan{}, kind, plan)}

  def update(transfer, {:ended, kind, {outcome, text}}),
    do: %{transfer | progress: nil, results: transfer.results ++ [{kind, {outcome, text}}]}

  defp joined(all, :mission, plan), do: %{all | items: plan.items, home: plan.home}
  defp joined(all, :fence, plan), do: %{all | fence: plan.fence, fence_return: plan.fence_return}
  defp joined(all, :rally, plan), do: %{all | rally: plan.rally}

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
