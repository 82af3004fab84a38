defmodule Aerie.Access.HTTP.ErrorTest do
  use ExUnit.Case, async: true

  alias Aerie.Access.HTTP.Error

  test "each reason of a refusal has its status, whatever its text says" do
    for {reason, status, message} <- [
          {{:unknown, :vehicle, "VID-009"}, 404, "no vehicle VID-009 is known"},
          {{:unknown, :link, "radio"}, 404, "there is no link radio"},
          {{:unknown, :owner, "gcs"}, 404, "there is no link and no client gcs"},
          {{:exists, :client, "gcs"}, 409, "there is already a client gcs"},
          {{:conflict, "the vehicle is armed"}, 409, "the vehicle is armed"},
          {{:invalid, "there is already no vehicle"}, 422, "there is already no vehicle"},
          {{:limit, "too many"}, 429, "too many"},
          {{:unavailable, "there is no link"}, 503, "there is no link"}
        ] do
      assert %Error{status: ^status, message: ^message} = Error.from(%Aerie.Base.Error{reason: reason})
    end

    hinted = %Aerie.Base.Error{reason: {:unknown, :vehicle, "VID-009"}, hint: "known are VID-001"}
    assert Error.from(hinted).message == "no vehicle VID-009 is known; known are VID-001"

    elsewhere = Aerie.Vehicle.Command.Result.new("a", :rejected, "ask that one", %{"rule" => "elsewhere"})
    assert %Error{status: 421, code: :misdirected, message: "ask that one"} = Error.of_result(elsewhere)

    for rule <- ~w(holder claim) do
      denied = Aerie.Vehicle.Command.Result.new("a", :denied, "nothing was sent", %{"rule" => rule})
      assert %Error{status: 503} = Error.of_result(denied)
    end

    refused = Error.new(:forbidden, "no")
    assert Error.from(refused) == refused
  end
end
