// What ns-3 costs in its leanest form: no IP stack, no traffic generator whose packets are dropped by full
// queues, a fixed received power for all stations. Processor time of this process per simulated second, in
// steady state: building the network and `warmup` simulated seconds are not part of it.
// --traffic=saturated: 802.11a, DCF; every sender gives its device the next packet when one has ended; one
// sink.
// --traffic=swarm: 802.11a with EDCA at 24 Mbit/s; every station broadcasts a packet every `period` seconds
// (best effort, phases drawn once), and `sessions` times a second one station exchanges frames of Fine Time
// Measurement's lengths with another one (AC_VO): a request of 42 B; then eight measurement frames, the
// first of 59 B and the others of 48 B, at least 200 us apart, each sent when the former is acknowledged.
// (Not 802.11ac: there 3.37 first sets up a Block Ack agreement between each pair of stations.)
// Prints traffic, stations, mode, payload_bytes, period_s, sessions_per_s, run, seconds, cpu_s per
// simulated second, wall_s per simulated second, PPDUs sent per simulated second, received payload of data
// in Mbit/s, completed sessions per simulated second, events of the simulator per simulated second.
#include "network.h"

#include <chrono>
#include <map>
#include <memory>

using namespace reference;

constexpr uint32_t REQUEST_BYTES = 42 - 26 - 4 - 8; // packets without MAC header, FCS and LLC/SNAP
constexpr uint32_t FIRST_MEASUREMENT_BYTES = 59 - 26 - 4 - 8;
constexpr uint32_t MEASUREMENT_BYTES = 48 - 26 - 4 - 8;
constexpr int MEASUREMENTS = 8;
constexpr uint8_t VOICE_PRIORITY = 6;
constexpr uint16_t FTM_ETHER_TYPE = 0x890d;

// Broadcasts and ranging of one station.
class SwarmStation
{
  public:
    SwarmStation(Ptr<NetDevice> device, uint32_t payloadBytes, Time period)
        : m_device(device),
          m_packetBytes(payloadBytes + UDP_IP_BYTES),
          m_period(period)
    {
        device->SetReceiveCallback(MakeCallback(&SwarmStation::Receive, this));
        MacOf(device)->TraceConnectWithoutContext("AckedMpdu", MakeCallback(&SwarmStation::Acked, this));
        MacOf(device)->TraceConnectWithoutContext("DroppedMpdu", MakeCallback(&SwarmStation::Dropped, this));
    }

    uint64_t broadcastsReceived = 0;
    uint64_t sessionsCompleted = 0;

    void Broadcast()
    {
        m_device->Send(Create<Packet>(m_packetBytes), m_device->GetBroadcast(), IPV4_ETHER_TYPE);
        Simulator::Schedule(m_period, &SwarmStation::Broadcast, this);
    }

    void Range(const Address& responder)
    {
        SendVoice(REQUEST_BYTES, responder);
    }

  private:
    void SendVoice(uint32_t bytes, const Address& to)
    {
        auto packet = Create<Packet>(bytes);
        SocketPriorityTag tag;
        tag.SetPriority(VOICE_PRIORITY);
        packet->AddPacketTag(tag);
        m_device->Send(packet, to, FTM_ETHER_TYPE);
    }

    bool Receive(Ptr<NetDevice>, Ptr<const Packet> packet, uint16_t protocol, const Address& from)
    {
        if (protocol != FTM_ETHER_TYPE)
        {
            broadcastsReceived++;
        }
        else if (packet->GetSize() == REQUEST_BYTES)
        {
            // a second session with the same initiator replaces the first one
            m_left[Mac48Address::ConvertFrom(from)] = MEASUREMENTS - 1;
            m_lastMeasurement = Simulator::Now();
            SendVoice(FIRST_MEASUREMENT_BYTES, from);
        }
        return true;
    }

    void Acked(Ptr<const WifiMpdu> mpdu)
    {
        const auto& header = mpdu->GetHeader();
        auto session = m_left.find(header.GetAddr1());
        if (header.IsData() && session != m_left.end() && mpdu->GetPacketSize() != REQUEST_BYTES + 8)
        {
            if (session->second == 0)
            {
                m_left.erase(session);
                sessionsCompleted++;
                return;
            }
            session->second--;
            const Time at = std::max(Simulator::Now(), m_lastMeasurement + MicroSeconds(200));
            m_lastMeasurement = at;
            Simulator::Schedule(at - Simulator::Now(),
                                &SwarmStation::SendVoice,
                                this,
                                MEASUREMENT_BYTES,
                                Address(header.GetAddr1()));
        }
    }

    void Dropped(WifiMacDropReason, Ptr<const WifiMpdu> mpdu)
    {
        m_left.erase(mpdu->GetHeader().GetAddr1());
    }

    Ptr<NetDevice> m_device;
    uint32_t m_packetBytes;
    Time m_period;
    std::map<Mac48Address, int> m_left; // measurement frames that are still to be sent, by initiator
    Time m_lastMeasurement;
};

int
main(int argc, char* argv[])
{
    std::string traffic = "saturated";
    uint32_t stations = 5;
    std::string mode = "OfdmRate6Mbps";
    uint32_t payloadBytes = 1000;
    double periodS = 0.1;
    double sessionsPerS = 0.0;
    double warmupS = 2.0;
    double seconds = 10.0;
    bool timeline = false;
    CommandLine command(__FILE__);
    command.AddValue("traffic", "saturated or swarm", traffic);
    command.AddValue("stations", "senders of saturated traffic, or all stations of a swarm", stations);
    command.AddValue("mode", "mode of saturated traffic", mode);
    command.AddValue("payload", "UDP payload, B", payloadBytes);
    command.AddValue("period", "period of a station's broadcasts, s", periodS);
    command.AddValue("sessions", "ranging sessions of the swarm per second", sessionsPerS);
    command.AddValue("warmup", "simulated time before the measurement, s", warmupS);
    command.AddValue("seconds", "measured simulated time", seconds);
    command.AddValue("timeline", "print transmissions", timeline);
    command.Parse(argc, argv);

    const bool swarm = traffic == "swarm";
    WifiSettings settings;
    if (swarm)
    {
        settings.qos = true;
        settings.groupMode = mode = "OfdmRate24Mbps";
    }
    settings.dataMode = mode;
    NodeContainer nodes(swarm ? stations : stations + 1);
    auto devices = InstallWifi(settings, nodes, EqualPower(-40.0), Circle(nodes.GetN(), 0.4));
    if (timeline)
    {
        PrintTransmissions(devices);
    }
    uint64_t ppdus = 0;
    for (uint32_t i = 0; i < devices.GetN(); i++)
    {
        DynamicCast<WifiNetDevice>(devices.Get(i))
            ->GetPhy()
            ->TraceConnectWithoutContext(
                "PhyTxPsduBegin",
                Callback<void, WifiConstPsduMap, WifiTxVector, double>(
                    [&ppdus](WifiConstPsduMap, WifiTxVector, double) { ppdus++; }));
    }

    std::unique_ptr<Sink> sink;
    std::vector<std::unique_ptr<SaturatedSender>> senders;
    std::vector<std::unique_ptr<SwarmStation>> members;
    auto random = CreateObject<UniformRandomVariable>();
    random->SetStream(1);
    std::function<void()> range = [&] {
        const uint32_t initiator = random->GetInteger(0, stations - 1);
        const uint32_t responder = (initiator + random->GetInteger(1, stations - 1)) % stations;
        members[initiator]->Range(devices.Get(responder)->GetAddress());
        Simulator::Schedule(Seconds(1.0 / sessionsPerS), range);
    };
    if (swarm)
    {
        for (uint32_t i = 0; i < stations; i++)
        {
            members.push_back(
                std::make_unique<SwarmStation>(devices.Get(i), payloadBytes, Seconds(periodS)));
            Simulator::Schedule(Seconds(random->GetValue(0, periodS)),
                                &SwarmStation::Broadcast,
                                members.back().get());
        }
        if (sessionsPerS > 0)
        {
            Simulator::Schedule(Seconds(1.0 / sessionsPerS), range);
        }
    }
    else
    {
        sink = std::make_unique<Sink>(devices.Get(stations));
        for (uint32_t i = 0; i < stations; i++)
        {
            senders.push_back(std::make_unique<SaturatedSender>(devices.Get(i),
                                                                devices.Get(stations)->GetAddress(),
                                                                payloadBytes,
                                                                2));
        }
    }

    double cpuS = 0.0;
    uint64_t events = 0;
    std::chrono::steady_clock::time_point begin;
    Simulator::Schedule(Seconds(warmupS), [&] {
        if (sink)
        {
            sink->Reset();
        }
        for (auto& member : members)
        {
            member->broadcastsReceived = member->sessionsCompleted = 0;
        }
        ppdus = 0;
        events = Simulator::GetEventCount();
        begin = std::chrono::steady_clock::now();
        cpuS = CpuSeconds();
    });
    Simulator::Stop(Seconds(warmupS + seconds));
    Simulator::Run();
    cpuS = CpuSeconds() - cpuS;
    const std::chrono::duration<double> wall = std::chrono::steady_clock::now() - begin;
    events = Simulator::GetEventCount() - events;

    double payloadMbps = sink ? sink->PayloadMbps(payloadBytes, seconds) : 0.0;
    uint64_t completed = 0;
    for (auto& member : members)
    {
        payloadMbps += member->broadcastsReceived * 8e-6 * payloadBytes / seconds;
        completed += member->sessionsCompleted;
    }
    std::cout << traffic << "," << stations << "," << mode << "," << payloadBytes << ","
              << (swarm ? periodS : 0.0) << "," << sessionsPerS << "," << RngSeedManager::GetRun() << ","
              << seconds << "," << cpuS / seconds << "," << wall.count() / seconds << "," << ppdus / seconds
              << "," << payloadMbps << "," << completed / seconds << "," << events / seconds << std::endl;
    Simulator::Destroy();
}
