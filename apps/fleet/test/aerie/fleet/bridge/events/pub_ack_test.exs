defmodule Aerie.Fleet.Bridge.Events.PubAckTest do
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Bridge.Events.PubAck

  @inbox "_INBOX.x"

  defp parse(ref, fields), do: PubAck.parse(Map.merge(%{topic: "#{@inbox}.#{ref}", body: ""}, fields), @inbox)

  test "confirmed, confirmed as a duplicate, refused, without a stream" do
    assert parse(7, %{body: ~s({"stream":"FLEET_EVENTS","seq":9})}) == {:confirmed, 7, false}
    assert parse(7, %{body: ~s({"stream":"FLEET_EVENTS","seq":9,"duplicate":true})}) == {:confirmed, 7, true}

    assert {:refused, 7, error} =
             parse(7, %{body: ~s({"error":{"code":503,"err_code":10077,"description":"full"}})})

    assert PubAck.text(error) == "full"
    refute PubAck.hopeless?(error)
    assert parse(7, %{status: "503"}) == {:refused, 7, :no_stream}
    assert {:refused, 7, :not_understood} = parse(7, %{body: "x"})
    assert {:refused, 7, :not_understood} = parse(7, %{body: "[]"})
  end

  test "other messages are not answers" do
    assert parse("x", %{}) == :other
    assert parse("1x", %{}) == :other
    assert PubAck.parse(%{topic: "other.1", body: ""}, @inbox) == :other
    assert PubAck.parse(%{topic: "#{@inbox}.1", body: ""}, nil) == :other
  end

  test "only what is wrong with the message itself is hopeless" do
    assert PubAck.hopeless?(%{"err_code" => 10_054})
    assert PubAck.hopeless?({:too_large, 2, 1})

    for reason <- [:no_stream, :not_understood, "the connection to NATS was lost"],
        do: refute(PubAck.hopeless?(reason))
  end

  test "reasons are texts" do
    for reason <- [:no_stream, "the connection to NATS was lost", "text", :not_understood],
        do: assert(PubAck.text(reason) =~ " " or reason == "text")
  end
end
