defmodule Aerie.Fleet.Bridge.Hub.Quota do
  @moduledoc """
  How much room a hub has for its vehicles: whatever each of them can fill by its key, so that none takes another one's. Pure.

  What a vehicle can fill is bounded, because its subjects are listed (`Aerie.Fleet.Bridge.Hub.Accounts`) and messages have a largest size.
  """

  alias Aerie.Fleet.Bridge.Message

  @kb 1_024
  @mb 1_048_576
  # A stored message beside its body.
  @beside 2 * @kb
  # A document in fleet_desired and how many it keeps, and one in fleet_reported (`Aerie.Fleet.Shadow.Store.Buckets`).
  @document 128 * @kb
  @documents 5
  # The share of the 20 GB in hub.conf for events: of each vehicle and of its gateway.
  @events_mb 16_384

  @type t :: %{
          state_mb: pos_integer(),
          event_mb: pos_integer(),
          desired_mb: pos_integer(),
          reported_mb: pos_integer()
        }

  @doc "The room for a number of vehicles, in megabytes; `event_mb` is that of one vehicle."
  @spec of(non_neg_integer()) :: t()
  def of(vehicles) do
    state = length(Message.state_groups()) * (Message.max_state_bytes() + @beside)

    %{
      state_mb: max(64, mb(vehicles * state)),
      event_mb: min(64, max(8, div(@events_mb, 2 * max(vehicles, 1)))),
      desired_mb: max(64, mb(vehicles * @documents * (@document + @beside))),
      reported_mb: max(32, mb(vehicles * (@document + @beside)))
    }
  end

  defp mb(bytes), do: div(bytes + @mb - 1, @mb)
end
