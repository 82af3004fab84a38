defmodule Gnat.Jetstream.ConsumerTest do
  use ExUnit.Case, async: true

  import Gnat.Test

  alias Gnat.{Error, Jetstream}
  alias Gnat.Jetstream.API.{Consumer, Message, Stream}
  alias Gnat.Jetstream.Pager
  alias Gnat.Test.NatsServer

  setup_all do
    {:ok, server: start_supervised!({NatsServer, jetstream: true})}
  end

  setup %{server: server} do
    {:ok, gnat} = Gnat.start_link(NatsServer.settings(server, %{no_responders: true}))
    stream = unique("S")
    {:ok, _} = Stream.create(gnat, %Stream{name: stream, subjects: [stream <> ".>"], storage: :memory})
    {:ok, gnat: gnat, stream: stream}
  end

  defp publish(gnat, stream, bodies) do
    for body <- bodies, do: {:ok, _} = store(gnat, stream <> ".a", "#{body}")
  end

  describe "consumers" do
    test "durable: created, described, listed, deleted", %{gnat: gnat, stream: stream} do
      consumer = %Consumer{
        stream_name: stream,
        durable_name: "d",
        description: "x",
        filter_subject: stream <> ".a"
      }

      assert {:ok, %{name: "d", stream_name: ^stream, config: config} = info} =
               Consumer.create(gnat, consumer)

      assert %{ack_policy: :explicit, deliver_policy: :all, replay_policy: :instant, durable_name: "d"} =
               config

      assert %{num_pending: 0, num_ack_pending: 0, delivered: %{consumer_seq: 0, stream_seq: 0}} = info
      assert {:ok, %{config: ^config, created: %DateTime{}}} = Consumer.info(gnat, stream, "d")
      assert {:ok, _} = Consumer.create(gnat, consumer)
      assert {:ok, %{consumers: ["d"], total: 1, offset: 0}} = Consumer.list(gnat, stream)
      assert :ok = Consumer.delete(gnat, stream, "d")
      assert {:error, %{"code" => 404}} = Consumer.info(gnat, stream, "d")
      assert {:ok, %{consumers: []}} = Consumer.list(gnat, stream)
    end

    test "from a point in time", %{gnat: gnat, stream: stream} do
      publish(gnat, stream, ["early"])
      {:ok, %{time: time}} = Stream.get_message(gnat, stream, %{seq: 1})
      later = DateTime.add(time, 1, :microsecond)
      consumer = %Consumer{stream_name: stream, deliver_policy: :by_start_time, opt_start_time: later}
      assert {:ok, %{config: %{opt_start_time: start}, num_pending: 0}} = Consumer.create(gnat, consumer)
      assert DateTime.compare(start, later) == :eq
    end

    test "the server's refusal is its error", %{gnat: gnat, stream: stream} do
      assert {:error, %{"description" => text}} =
               Consumer.create(gnat, %Consumer{stream_name: stream, deliver_policy: :by_start_sequence})

      assert text =~ "start sequence"
      assert {:error, %{"code" => 404}} = Consumer.create(gnat, %Consumer{stream_name: "nowhere"})
      assert {:error, %{"code" => 404}} = Consumer.list(gnat, "nowhere")
    end

    test "invalid configurations are refused locally", %{gnat: gnat, stream: stream} do
      good = %Consumer{stream_name: stream}

      for {consumer, text} <- [
            {%{good | stream_name: "a.b"}, "stream_name"},
            {%{good | stream_name: nil}, "stream_name must be a string"},
            {%{good | durable_name: "a b"}, "durable_name"},
            {%{good | ack_policy: :some}, "ack policy"},
            {%{good | deliver_policy: :some}, "deliver policy"},
            {%{good | replay_policy: :some}, "replay policy"}
          ] do
        assert {:error, why} = Consumer.create(gnat, consumer)
        assert why =~ text
      end

      assert {:error, _} = Consumer.info(gnat, stream, "a.b")
      assert {:error, _} = Consumer.delete(gnat, "a.b", "c")
    end
  end

  describe "pulling" do
    setup %{gnat: gnat, stream: stream} do
      {:ok, _} =
        Consumer.create(gnat, %Consumer{stream_name: stream, durable_name: "d"})

      {:ok, _} = Gnat.sub(gnat, self(), "inbox." <> stream)

      {:ok,
       next: fn opts -> Consumer.request_next_message(gnat, stream, "d", "inbox." <> stream, nil, opts) end}
    end

    test "delivers messages with their position", %{gnat: gnat, stream: stream, next: next} do
      publish(gnat, stream, [1, 2])
      # The server confirms a message before its consumers have counted it.
      eventually(fn -> match?({:ok, %{num_pending: 2}}, Consumer.info(gnat, stream, "d")) end)
      :ok = next.(batch: 2)
      assert_receive {:msg, %{body: "1"} = first}
      assert_receive {:msg, %{body: "2"} = second}

      assert {:ok,
              %Message.Metadata{stream_seq: 1, consumer_seq: 1, num_delivered: 1, num_pending: 1} = metadata} =
               Message.metadata(first)

      assert %{stream: ^stream, consumer: "d", domain: nil, timestamp: %DateTime{}} = metadata
      assert {:ok, %{stream_seq: 2, num_pending: 0}} = Message.metadata(second)
    end

    test "acknowledges in each way", %{gnat: gnat, stream: stream, next: next} do
      publish(gnat, stream, [1, 2])
      :ok = next.([])
      assert_receive {:msg, %{body: "1"} = one}
      assert :ok = Jetstream.ack_next(one, "inbox." <> stream)
      assert_receive {:msg, %{body: "2"} = two}
      assert :ok = Jetstream.nack(two)
      :ok = next.([])
      assert_receive {:msg, %{body: "2"} = again}
      assert {:ok, %{num_delivered: 2}} = Message.metadata(again)
      assert :ok = Jetstream.ack(again)
      publish(gnat, stream, [3, 4])
      :ok = next.([])
      assert_receive {:msg, %{body: "3"} = three}
      assert :ok = Jetstream.ack_progress(three)
      assert :ok = Jetstream.ack_term(three)
      :ok = next.([])
      assert_receive {:msg, %{body: "4"} = four}
      assert :ok = Jetstream.ack(four)
      :ok = Gnat.flush(gnat)

      eventually(fn ->
        match?({:ok, %{num_ack_pending: 0, ack_floor: %{stream_seq: 4}}}, Consumer.info(gnat, stream, "d"))
      end)
    end

    test "with no_wait reports that there is no message", %{next: next} do
      :ok = next.(no_wait: true)
      assert_receive {:msg, %{status: "404", body: ""}}
    end

    test "with expires reports the end, with heartbeats before", %{next: next} do
      :ok = next.(expires: 400_000_000, idle_heartbeat: 100_000_000)
      assert_receive {:msg, %{status: "100"}}
      assert_receive {:msg, %{status: "408"}}
    end
  end

  test "a message without a reply address cannot be acknowledged", %{gnat: gnat} do
    message = %{topic: "a", body: "", reply_to: nil, gnat: gnat}

    for ack <- [:ack, :nack, :ack_progress, :ack_term] do
      assert {:error, "Cannot ack message with no reply-to"} = apply(Jetstream, ack, [message])
    end

    assert {:error, _} = Jetstream.ack_next(message, "x")
  end

  describe "metadata" do
    test "of the long form has a domain" do
      subject = "$JS.ACK.hub.acchash.S.c.1.2.3.1700000000000000000.4.rnd"
      assert {:ok, %{domain: "hub", stream: "S", stream_seq: 2}} = Message.metadata(%{reply_to: subject})
      subject = "$JS.ACK._.acchash.S.c.1.2.3.1700000000000000000.4"
      assert {:ok, %{domain: nil, consumer: "c", num_pending: 4}} = Message.metadata(%{reply_to: subject})
    end

    test "of an invalid address is an error" do
      for {reply_to, reason} <- [
            {nil, :no_jetstream_message},
            {"_INBOX.a", :no_jetstream_message},
            {"$JS.ACK.", :invalid_ack_reply_to},
            {"$JS.ACK.S.c.1.2.3.x.4", :invalid_ack_reply_to},
            {"$JS.ACK.S.c.1.2.-3.0.4", :invalid_ack_reply_to},
            {"$JS.ACK.S.c.1.2.3.999999999999999999999999.4", :invalid_ack_reply_to}
          ] do
        assert {:error, ^reason} = Message.metadata(%{reply_to: reply_to})
      end
    end
  end

  describe "the pager" do
    test "reads the present messages, from the given position", %{gnat: gnat, stream: stream} do
      assert {:ok, []} = read(gnat, stream, [])
      publish(gnat, stream, 1..25)
      all = Enum.map(1..25, &"#{&1}")
      for batch <- [1, 5, 10, 25, 100], do: assert({:ok, ^all} = read(gnat, stream, batch: batch))
      assert {:ok, ["24", "25"]} = read(gnat, stream, from_seq: 24)
      {:ok, %{time: time}} = Stream.get_message(gnat, stream, %{seq: 25})
      assert {:ok, ["25"]} = read(gnat, stream, from_datetime: time)

      assert {:ok, ["25"]} =
               read(gnat, stream, deliver_policy: :last_per_subject, filter_subject: stream <> ".>")

      assert {:ok, []} = read(gnat, stream, filter_subject: stream <> ".other")
      assert {:ok, ["", ""]} = read(gnat, stream, from_seq: 24, headers_only: true)
      assert {:ok, %{consumers: []}} = Consumer.list(gnat, stream)
      refute_received {:msg, _}
    end

    test "gives pages", %{gnat: gnat, stream: stream} do
      publish(gnat, stream, 1..5)
      {:ok, pager} = Pager.init(gnat, stream, batch: 3)
      assert {:page, [%{body: "1"}, _, _]} = Pager.page(pager)
      assert {:done, [%{body: "4"}, %{body: "5"}]} = Pager.page(pager)
      assert :ok = Pager.cleanup(pager)
    end

    test "ends at the message that was the last one at the start", %{gnat: gnat, stream: stream} do
      publish(gnat, stream, 1..3)

      assert {:ok, 3} =
               Pager.reduce(gnat, stream, [batch: 1], 0, fn _message, n ->
                 publish(gnat, stream, ["more"])
                 n + 1
               end)
    end

    test "tidies up when its function raises", %{gnat: gnat, stream: stream} do
      publish(gnat, stream, 1..3)
      assert_raise RuntimeError, fn -> Pager.reduce(gnat, stream, [], 0, fn _, _ -> raise "no" end) end
      assert {:ok, %{consumers: []}} = Consumer.list(gnat, stream)
      assert {:ok, 1} = Gnat.active_subscriptions(gnat)
    end

    test "is an error without a stream or a connection", %{gnat: gnat} do
      assert {:error, %{"code" => 404}} = read(gnat, "nowhere", [])
      Gnat.stop(gnat)
      assert {:error, %Error{reason: :not_connected}} = read(gnat, "nowhere", [])
    end

    defp read(gnat, stream, opts) do
      with {:ok, bodies} <- Pager.reduce(gnat, stream, opts, [], fn %{body: body}, all -> [body | all] end) do
        {:ok, Enum.reverse(bodies)}
      end
    end
  end
end
